"""The newest frame of every camera, straight from shared memory."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from nearfield_server.capture.frame_ring import FrameRingReader, FrameView
from nearfield_server.records import CameraFrame

STALE_AFTER_S = 1.0
_COPY_ROUNDS = 100
_GONE_AFTER_PERIODS = 4.0
# Above every revision that a ring hands out (writer generation << 40): marks pictures that must not be taken for their originals.
_RETRY_REVISION = 1 << 62


@dataclass(slots=True)
class FrameCollector:
    """Takes the newest whole frame of each ring without copying, and tells afterwards whether they stayed whole.

    When the pipeline was too slow and a camera overwrote a frame in use, frames are copied for a while instead.
    """

    readers: Sequence[FrameRingReader]
    torn: int = 0
    had_news: bool = False
    """Whether a camera delivered or confirmed a picture between the last two calls of `collect`."""
    _confirmed: list[int] = field(default_factory=list)
    # Cameras of which a torn picture was used: what was derived from its tiles is wrong, whatever their revisions say.
    _distrusted: set[int] = field(default_factory=set)
    _views: list[FrameView | None] = field(default_factory=list)
    _copy_rounds: int = 0
    _retries: itertools.count[int] = field(default_factory=lambda: itertools.count(_RETRY_REVISION))

    def is_complete(self, period_s: float) -> bool:
        """Whether every camera that still delivers has done so in the period of the newest picture."""
        confirmed = [reader.confirmed_ns for reader in self.readers]
        ages_s = [(max(confirmed) - each) * 1e-9 for each in confirmed]
        return all(age < 0.5 * period_s or age > _GONE_AFTER_PERIODS * period_s for age in ages_s)

    def collect(self) -> list[CameraFrame | None]:
        """Return the newest frame per camera, or None where a camera has not delivered any yet."""
        confirmed = [reader.confirmed_ns for reader in self.readers]
        self.had_news, self._confirmed = confirmed != self._confirmed, confirmed
        if self._copy_rounds > 0:
            self._copy_rounds -= 1
            self._views = []
            frames = [reader.newest_copy(index) for index, reader in enumerate(self.readers)]
        else:
            self._views = [reader.newest() for reader in self.readers]
            frames = [
                None if view is None else view.as_frame(index) for index, view in enumerate(self._views)
            ]
        return [None if frame is None else self._with_trusted_tiles(frame) for frame in frames]

    def stayed_whole(self) -> bool:
        """Whether no frame of the last `collect` was overwritten since; if one was, the next rounds copy."""
        torn = {
            index for index, view in enumerate(self._views) if view is not None and not view.still_valid()
        }
        if torn:
            self.torn += 1
            self._copy_rounds = _COPY_ROUNDS
            self._distrusted |= torn
        return not torn

    def recollect(self) -> list[CameraFrame | None]:
        """Return copies under revisions never used before: what was derived from torn pictures is made again."""
        frames = [reader.newest_copy(index) for index, reader in enumerate(self.readers)]
        self._views = []
        return [
            None
            if frame is None
            else replace(self._with_trusted_tiles(frame), content_revision=next(self._retries))
            for frame in frames
        ]

    def _with_trusted_tiles(self, frame: CameraFrame) -> CameraFrame:
        """Without tile revisions, once, if a torn picture of the camera went before."""
        if frame.camera_index not in self._distrusted:
            return frame
        self._distrusted.discard(frame.camera_index)
        return replace(frame, tile_revisions=None)


def camera_report(
    readers: Sequence[FrameRingReader],
    camera_ids: Sequence[str],
    now_ns: int,
    stale_after_s: float = STALE_AFTER_S,
) -> list[dict[str, Any]]:
    """Return age and staleness per camera, for the status message; a camera that never delivered has age null and is stale."""
    report = []
    for reader, camera_id in zip(readers, camera_ids, strict=True):
        confirmed_ns = reader.confirmed_ns
        age_s = (now_ns - confirmed_ns) * 1e-9 if confirmed_ns else np.inf
        report.append(
            {
                "camera_id": camera_id,
                "age_s": round(max(age_s, 0.0), 4) if np.isfinite(age_s) else None,
                "stale": bool(age_s > stale_after_s),
                "generation": reader.generation,
            }
        )
    return report
