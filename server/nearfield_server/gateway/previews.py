"""Previews of the cameras for the pages: asked of the capture processes over the bus, never more often than a few times a second."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import Annotated, Protocol

from fastapi import FastAPI, Query
from fastapi.responses import PlainTextResponse, Response

from nearfield_server.bus.keys import preview_key
from nearfield_server.bus.messages import PreviewRequest
from nearfield_server.errors import BusError

_KEEP_S = 0.25
_TIMEOUT_S = 2.0
_KEPT_KINDS = 8


class Asker(Protocol):
    """The part of the message bus that previews use."""

    def ask(self, key: str, timeout_s: float = 1.0, question: bytes = b"") -> bytes | None:
        """Return the first answer to a question, None if there is none in time."""


class CameraPreviews:
    """Previews by camera. Many tablets that look at the same camera cost as much as one.

    Args:
        bus: where capture processes answer.
        camera_ids: in the order of the room file; camera n is the process `cam<n>`.
    """

    def __init__(self, bus: Asker, camera_ids: Sequence[str]) -> None:
        self.camera_ids = tuple(camera_ids)
        self._bus = bus
        self._locks = [asyncio.Lock() for _ in self.camera_ids]
        self._kept: list[dict[PreviewRequest, tuple[float, bytes]]] = [{} for _ in self.camera_ids]

    async def jpeg(self, camera_index: int, request: PreviewRequest) -> bytes:
        """JPEG of the newest picture of a camera; empty when its process does not answer or has no picture yet."""
        kept = self._kept[camera_index]
        async with self._locks[camera_index]:
            found = kept.get(request)
            if found is not None and time.monotonic() - found[0] < _KEEP_S:
                return found[1]
            question = request.to_json()
            try:
                key = preview_key(f"cam{camera_index}")
                answer = await asyncio.to_thread(self._bus.ask, key, _TIMEOUT_S, question) or b""
            except BusError:
                answer = b""
            if len(kept) >= _KEPT_KINDS:
                kept.clear()
            kept[request] = (time.monotonic(), answer)
            return answer


def add_preview_routes(app: FastAPI, previews: CameraPreviews) -> None:
    """Add `GET /api/cameras/<id>/preview.jpg?size=384&stops=0&marks=1`."""

    @app.get("/api/cameras/{camera_id}/preview.jpg")
    async def get_preview(
        camera_id: str,
        size: Annotated[int, Query(ge=16, le=1024)] = 384,
        stops: Annotated[float, Query(ge=-20, le=20, allow_inf_nan=False)] = 0.0,
        marks: bool = True,
    ) -> Response:
        headers = {"Cache-Control": "no-store"}
        if camera_id not in previews.camera_ids:
            known = ", ".join(previews.camera_ids)
            return PlainTextResponse(f"No camera {camera_id!r}; there are: {known}\n", 404, headers)
        request = PreviewRequest(max_side=size, stops=stops, marks=marks)
        data = await previews.jpeg(previews.camera_ids.index(camera_id), request)
        if not data:
            return PlainTextResponse(f"Camera {camera_id!r} has no picture (yet)\n", 503, headers)
        return Response(data, media_type="image/jpeg", headers=headers)
