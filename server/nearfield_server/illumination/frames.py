"""The frames of all cameras that belong together, straight from shared memory."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from nearfield_server.capture.frame_ring import FrameRingReader, FrameView
from nearfield_server.illumination.pairing import Picture, PictureSet, choose_pictures
from nearfield_server.records import CameraFrame

STALE_AFTER_S = 1.0
_COPY_ROUNDS = 100
_GONE_AFTER_PERIODS = 4.0
# Above every revision that a ring hands out (writer generation << 40): marks pictures that must not be taken for their originals.
_RETRY_REVISION = 1 << 62


class FrameSource(Protocol):
    """Where the illumination takes frames from: the rings (`FrameCollector`) or a recording."""

    had_news: bool
    torn: int
    always_copies: bool
    pictures: PictureSet

    def collect(self) -> list[CameraFrame | None]:
        """The frame in use of every camera, or None before its first one."""

    def stayed_whole(self) -> bool:
        """Whether no frame of the last `collect` was overwritten since."""

    def recollect(self) -> list[CameraFrame | None]:
        """Copies under revisions never used before."""

    def report(self, camera_ids: Sequence[str], now_ns: int, stale_after_s: float) -> list[dict[str, Any]]:
        """Age and staleness per camera, see `camera_report`."""


@dataclass(slots=True)
class FrameCollector:
    """Takes the frames that belong together (`pairing`) without copying, and tells afterwards whether they stayed whole.

    When the pipeline was too slow and a camera overwrote a frame in use, frames are copied for a while instead.

    Attributes:
        readers: the rings, in the order of the room file.
        period_s: between two frames of a camera.
        torn: how often a frame was overwritten while it was in use.
        had_news: whether a camera delivered or confirmed a picture between the last two calls of `collect`.
        pictures: what `collect` chose last.
        always_copies: use copies alone: nothing in use is ever overwritten, so that a recording can say what every update was made of.
        clock: CLOCK_MONOTONIC, ns.
    """

    readers: Sequence[FrameRingReader]
    period_s: float = 1.0 / 30.0
    torn: int = 0
    had_news: bool = False
    pictures: PictureSet = field(default_factory=lambda: choose_pictures((), (), 0))
    clock: Callable[[], int] = time.monotonic_ns
    always_copies: bool = False
    _confirmed: list[int] = field(default_factory=list)
    # Per camera: the frame used last, and the newest one with the time when it was seen first.
    _used: list[int] = field(default_factory=list)
    _seen: list[tuple[int, int]] = field(default_factory=list)
    # Cameras of which a torn picture was used: what was derived from its tiles is wrong, whatever their revisions say.
    _distrusted: set[int] = field(default_factory=set)
    _views: list[FrameView | None] = field(default_factory=list)
    _copy_rounds: int = 0
    _copies: list[CameraFrame | None] = field(default_factory=list)
    _retries: itertools.count[int] = field(default_factory=lambda: itertools.count(_RETRY_REVISION))

    def __post_init__(self) -> None:
        self._used = [0] * len(self.readers)
        self._seen = [(0, 0)] * len(self.readers)
        self._copies = [None] * len(self.readers)

    def is_complete(self, period_s: float) -> bool:
        """Whether every camera that still delivers has done so in the period of the newest picture."""
        confirmed = [reader.confirmed_ns for reader in self.readers]
        ages_s = [(max(confirmed) - each) * 1e-9 for each in confirmed]
        return all(age < 0.5 * period_s or age > _GONE_AFTER_PERIODS * period_s for age in ages_s)

    def collect(self) -> list[CameraFrame | None]:
        """Return the frame in use of every camera, or None where a camera has not delivered any yet."""
        confirmed = [reader.confirmed_ns for reader in self.readers]
        self.had_news, self._confirmed = confirmed != self._confirmed, confirmed
        views = self._choose()
        if self.always_copies or self._copy_rounds > 0:
            self._copy_rounds = max(self._copy_rounds - 1, 0)
            self._views = []
            frames = [self._copy(index, view) for index, view in enumerate(views)]
        else:
            self._views = views
            frames = [None if view is None else view.as_frame(index) for index, view in enumerate(views)]
        self._note_used(frames)
        return [None if frame is None else self._with_trusted_tiles(frame) for frame in frames]

    def _choose(self) -> list[FrameView | None]:
        """Views of the frames that belong together; older frames are only looked at where the newest ones do not match."""
        now_ns, period_ns = self.clock(), round(self.period_s * 1e9)
        held: list[list[FrameView]] = []
        for index, reader in enumerate(self.readers):
            newest = reader.newest()
            held.append([] if newest is None else [newest])
            if newest is not None and newest.sequence != self._seen[index][0]:
                self._seen[index] = (newest.sequence, now_ns)
        pictures = [_as_pictures(views, period_ns) for views in held]
        self.pictures = choose_pictures(pictures, self._used, period_ns)
        if self.pictures.spread_ns > period_ns // 4:
            for reader, views, used in zip(self.readers, held, self._used, strict=True):
                _add_older(reader, views, used)
            pictures = [_as_pictures(views, period_ns) for views in held]
            self.pictures = choose_pictures(pictures, self._used, period_ns)
            if self.pictures.is_holding and self._is_held_too_long(now_ns - period_ns):
                self.pictures = choose_pictures(pictures, self._used, period_ns, hold=False)
        return [
            None if picture is None else next(view for view in views if view.sequence == picture.sequence)
            for picture, views in zip(self.pictures.chosen, held, strict=True)
        ]

    def _is_held_too_long(self, seen_before_ns: int) -> bool:
        """Whether a frame has waited for those of other cameras since then: they may have stopped all together."""
        return any(
            picture is not None and picture.sequence != sequence and seen_ns < seen_before_ns
            for picture, (sequence, seen_ns) in zip(self.pictures.chosen, self._seen, strict=True)
        )

    def _copy(self, index: int, view: FrameView | None) -> CameraFrame | None:
        if view is None:
            return None
        kept = self._copies[index]
        if kept is not None and kept.content_revision == view.content_revision:
            return kept
        frame = replace(view.as_frame(index), pixels=view.pixels.copy())
        self._copies[index] = frame if view.still_valid() else self.readers[index].newest_copy(index)
        return self._copies[index]

    def _note_used(self, frames: Sequence[CameraFrame | None]) -> None:
        for frame in frames:
            if frame is not None:
                self._used[frame.camera_index] = frame.sequence

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
        self._note_used(frames)
        return [
            None
            if frame is None
            else replace(self._with_trusted_tiles(frame), content_revision=next(self._retries))
            for frame in frames
        ]

    def report(self, camera_ids: Sequence[str], now_ns: int, stale_after_s: float) -> list[dict[str, Any]]:
        """Age and staleness per camera, see `camera_report`."""
        return camera_report(self.readers, camera_ids, now_ns, stale_after_s, self.pictures)

    def _with_trusted_tiles(self, frame: CameraFrame) -> CameraFrame:
        """Without tile revisions, once, if a torn picture of the camera went before."""
        if frame.camera_index not in self._distrusted:
            return frame
        self._distrusted.discard(frame.camera_index)
        return replace(frame, tile_revisions=None)


def _as_pictures(views: Sequence[FrameView], period_ns: int) -> list[Picture]:
    """Frames of one camera by ascending sequence; one that was followed by another was confirmed until a period before that."""
    pictures = [
        Picture(view.sequence, view.timestamp_ns, max(view.timestamp_ns, after.timestamp_ns - period_ns))
        for view, after in itertools.pairwise(views)
    ]
    if views:
        newest = views[-1]
        until_ns = max(newest.timestamp_ns, newest.confirmed_ns)
        pictures.append(Picture(newest.sequence, newest.timestamp_ns, until_ns))
    return pictures


def _add_older(reader: FrameRingReader, views: list[FrameView], used: int) -> None:
    """Put the older frames that are still whole before the newest one, down to the one used last."""
    while views and views[0].sequence > max(used, 1):
        older = reader.at(views[0].sequence - 1)
        if older is None:
            break
        views.insert(0, older)


def camera_report(
    readers: Sequence[FrameRingReader],
    camera_ids: Sequence[str],
    now_ns: int,
    stale_after_s: float = STALE_AFTER_S,
    pictures: PictureSet | None = None,
) -> list[dict[str, Any]]:
    """Return age and staleness per camera, for the status message.

    Args:
        readers: the rings.
        camera_ids: names.
        now_ns: CLOCK_MONOTONIC.
        stale_after_s: age above which a camera counts as stale.
        pictures: what is in use.

    Returns:
        Per camera: `age_s` since the camera last delivered or confirmed a picture (None and stale if it never did), `picture_age_s` since
        the picture in use was taken, `paired`: it is meant to show the same moment as those of the other paired cameras, `generation`.
    """
    report = []
    for index, (reader, camera_id) in enumerate(zip(readers, camera_ids, strict=True)):
        confirmed_ns = reader.confirmed_ns
        age_s = (now_ns - confirmed_ns) * 1e-9 if confirmed_ns else np.inf
        has_set = pictures is not None and index < len(pictures.chosen)
        picture = pictures.chosen[index] if pictures is not None and has_set else None
        report.append(
            {
                "camera_id": camera_id,
                "age_s": round(max(age_s, 0.0), 4) if np.isfinite(age_s) else None,
                "picture_age_s": round(max(now_ns - picture.from_ns, 0) * 1e-9, 4) if picture else None,
                "paired": bool(pictures is not None and has_set and pictures.present[index]),
                "stale": bool(age_s > stale_after_s),
                "generation": reader.generation,
            }
        )
    return report
