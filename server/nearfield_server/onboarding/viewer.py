"""Looks through one camera whenever somebody asks, and lets it go when nobody does.

A device is used from one thread only, so each camera has one. The device stays open between two looks of a person who moves a slider,
and is closed a few seconds after the last one: a page that was left open keeps no camera from others.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.device import Device, DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.errors import CaptureError, NearfieldError
from nearfield_server.onboarding.look import Look, take_look

FRAME_LIMIT_S = 2.0
_MOST_WAITING = 64
IDLE_S = 6.0

Decode = Callable[[SensorFrame], NDArray[np.float32]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """How somebody wants to look: exposure time in seconds (None = as it is), and whether saturated pixels are marked."""

    exposure_s: float | None = None
    marks: bool = True


class Viewer:
    """One camera.

    Args:
        make_device: makes the device, unopened; called again after failures.
        decode: codes of a frame as (H, W, 4) float32 share of the signal range.
        idle_s: seconds after the last look until the device is closed.
    """

    def __init__(self, make_device: Callable[[], Device], decode: Decode, *, idle_s: float = IDLE_S) -> None:
        self._make_device, self._decode, self._idle_s = make_device, decode, idle_s
        self._wishes: queue.Queue[tuple[Wish, Future[Look]] | None] = queue.Queue()
        self._device: Device | None = None
        self._capabilities: DeviceCapabilities | None = None
        self._commanded: float | None = None
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()

    def look(self, wish: Wish) -> Look:
        """Take a picture; waits for it.

        Raises:
            CaptureError: the camera cannot be opened, sends nothing, or the viewer is closed.
        """
        if not self._thread.is_alive():
            raise CaptureError("the viewer is closed")
        answer: Future[Look] = Future()
        self._wishes.put((wish, answer))
        return answer.result()

    def close(self) -> None:
        """Let the camera go and end the thread; may be called twice."""
        self._wishes.put(None)
        self._thread.join(timeout=10.0)

    def _run(self) -> None:
        while True:
            try:
                task = self._wishes.get(timeout=self._idle_s if self._device is not None else None)
            except queue.Empty:
                self._let_go()
                continue
            if task is None:
                break
            wish, answer = task
            try:
                answer.set_result(self._look(wish))
            except Exception as error:
                self._let_go()
                known = (
                    error
                    if isinstance(error, NearfieldError)
                    else CaptureError(f"the picture failed: {error!r}")
                )
                answer.set_exception(known)
        self._let_go()
        with contextlib.suppress(queue.Empty):
            while True:
                left = self._wishes.get_nowait()
                if left is not None:
                    left[1].set_exception(CaptureError("the viewer is closed"))

    def _look(self, wish: Wish) -> Look:
        if self._device is None:
            device = self._make_device()
            self._device = device  # from now on it is closed if anything fails
            self._capabilities, self._commanded = device.open(), None
        device, capabilities = self._device, self._capabilities
        assert capabilities is not None
        # What waits in the queue was exposed before now.
        for _ in range(_MOST_WAITING):
            waiting = device.next_frame(0.0)
            if waiting is None:
                break
            device.release(waiting)
        for _ in range(self._command(device, capabilities, wish.exposure_s)):
            device.release(self._wait(device))
        frame = self._wait(device)
        try:
            signal = self._decode(frame)
            exposure_s, pixel_format = frame.exposure.time_s, frame.pixel_format
        finally:
            device.release(frame)
        return take_look(
            signal,
            pixel_format=pixel_format,
            exposure_s=exposure_s,
            exposure_range_s=capabilities.exposure_range_s,
            marks=wish.marks,
        )

    def _command(self, device: Device, capabilities: DeviceCapabilities, exposure_s: float | None) -> int:
        """Set an exposure if it is a new one; how many frames may still have the one before."""
        if exposure_s is None or exposure_s == self._commanded:
            return 0
        self._commanded = exposure_s
        shortest, longest = capabilities.exposure_range_s
        if shortest >= longest:
            return 0
        device.set_exposure(Exposure(time_s=min(max(exposure_s, shortest), longest)))
        return capabilities.settle_frames

    @staticmethod
    def _wait(device: Device) -> SensorFrame:
        frame = device.next_frame(FRAME_LIMIT_S)
        if frame is None:
            raise CaptureError(
                f"it sends no picture within {FRAME_LIMIT_S:.0f} s; check its trigger settings"
            )
        return frame

    def _let_go(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            with contextlib.suppress(NearfieldError):
                device.close()
