"""The newest picture of every camera, and what of it differs from the one that was gathered last."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import ConfigError
from nearfield_server.records import FRAME_TILE, CameraFrame


class FrameTracker:
    """Keeps the pictures in use and the revisions of those that the radiance was made from."""

    def __init__(self, camera_shapes: Sequence[tuple[int, int]]) -> None:
        num_cameras = len(camera_shapes)
        self._tile_shapes = [
            (-(-rows // FRAME_TILE), -(-columns // FRAME_TILE)) for rows, columns in camera_shapes
        ]
        self.frames: list[CameraFrame | None] = [None] * num_cameras
        self._gathered: list[int | None] | None = None
        self._gathered_tiles: list[NDArray[np.int64] | None] = [None] * num_cameras

    def take(self, frames: Sequence[CameraFrame | None]) -> None:
        """Replace the pictures of cameras that have a new one.

        Raises:
            ConfigError: the number or the order of the pictures is wrong.
        """
        if len(frames) != len(self.frames):
            raise ConfigError(
                f"expected one picture or None per camera ({len(self.frames)}), found {len(frames)}"
            )
        for index, frame in enumerate(frames):
            if frame is None:
                continue
            if frame.camera_index != index:
                raise ConfigError(
                    f"picture {index} belongs to camera {frame.camera_index}; pass them in camera order"
                )
            self.frames[index] = frame

    def has_news(self) -> bool:
        """Whether any picture is another one than that gathered last."""
        return self._revisions() != self._gathered

    def changed_tiles(self) -> list[NDArray[np.bool_]] | None:
        """Tiles that differ from the pictures gathered last, per camera; None where that is not known of all cameras."""
        if self._gathered is None:
            return None
        result = []
        for frame, revision, tiles, shape in zip(
            self.frames, self._gathered, self._gathered_tiles, self._tile_shapes, strict=True
        ):
            newest = None if frame is None else frame.tile_revisions
            if frame is None or frame.content_revision == revision:
                result.append(np.zeros(shape, dtype=np.bool_))
            elif newest is None or tiles is None or not newest.shape == tiles.shape == shape:
                return None
            else:
                result.append(newest != tiles)
        return result

    def forget(self) -> None:
        """Count nothing as gathered: what was made of the pictures may be half done."""
        self._gathered = None

    def mark_gathered(self) -> None:
        """Remember that the radiance shows the pictures in use."""
        self._gathered = self._revisions()
        # Copies: the reader of the next picture may reuse the memory.
        self._gathered_tiles = [
            None if frame is None or frame.tile_revisions is None else frame.tile_revisions.copy()
            for frame in self.frames
        ]

    def _revisions(self) -> list[int | None]:
        return [None if frame is None else frame.content_revision for frame in self.frames]
