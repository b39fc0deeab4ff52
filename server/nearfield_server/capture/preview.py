"""Answers to questions for a preview: the newest frame of a ring as a small JPEG, painted only when someone asks."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

from nearfield_server.bus.messages import PreviewRequest
from nearfield_server.capture.frame_ring import FrameRingReader
from nearfield_server.imaging.preview import encode_jpeg, paint_preview

_ATTEMPTS = 3


class PreviewPainter:
    """Paints the newest frame of a ring. An unchanged frame is not painted again for the same request.

    Args:
        ring: a reader of its own.
        circle: (H, W) bool, where the lens shows anything; None = everywhere.
    """

    def __init__(self, ring: FrameRingReader, circle: NDArray[np.bool_] | None = None) -> None:
        self._ring, self._circle = ring, circle
        self._lock = threading.Lock()
        self._painted: tuple[int, PreviewRequest, bytes] | None = None

    def answer(self, question: bytes) -> bytes:
        """JPEG of the newest frame; empty if there is none yet. May be called from any thread.

        Raises:
            BusError: the question is malformed.
        """
        request = PreviewRequest.from_json(question)
        with self._lock:
            for _ in range(_ATTEMPTS):
                view = self._ring.newest()
                if view is None:
                    return b""
                if self._painted is not None and self._painted[:2] == (view.content_revision, request):
                    return self._painted[2]
                picture = paint_preview(
                    view.pixels,
                    max_side=request.max_side,
                    stops=request.stops,
                    marks=request.marks,
                    circle=self._circle,
                )
                # Painted straight from shared memory: the writer may have gone over it meanwhile.
                if view.still_valid():
                    self._painted = (view.content_revision, request, encode_jpeg(picture))
                    return self._painted[2]
        return b""
