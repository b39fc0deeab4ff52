"""A recorded camera: the very pictures of that time, at the original speed or another one, in step with the other cameras."""

from __future__ import annotations

import threading
import time
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import structlog

from nearfield_server.capture.source import RawFrame
from nearfield_server.errors import AssetError, CaptureError
from nearfield_server.recording.files.library import Track, open_recording
from nearfield_server.recording.files.timeline import make_timeline

_MAX_WAIT_S: Final = 0.1
_MAX_HOLD_NS: Final = 120 * 10**9
"""How long the first picture is held for the other processes of the service."""

_log = structlog.get_logger("nearfield.capture")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedCamera:
    """One camera of a recording.

    Attributes:
        camera_id: its name in the recording.
        folder: of the recording.
        height: pixels expected. width: pixels expected.
        speed: times the original speed, > 0.
        loop: begin again after the end; otherwise the last picture stays, and grows old.
        origin_ns: CLOCK_MONOTONIC at which all cameras of the service begin together; None while that is not known. The first picture is
            shown until then.
    """

    camera_id: str
    folder: Path
    height: int
    width: int
    speed: float = 1.0
    loop: bool = True
    origin_ns: Callable[[], int | None] = lambda: 0


@dataclass(slots=True)
class RecordingSource:
    """`Source` of a recorded camera. A damaged frame is dropped, counted and told once; the recording goes on."""

    camera: RecordedCamera
    _track: Track | None = None
    _due_ns: tuple[int, ...] = ()
    _duration_ns: int = 1
    _opened_ns: int | None = None
    _position: int = -1
    _frame: RawFrame | None = None
    _revision: int = 0
    _elapsed_ns: int = 0
    _rounds: int = 0
    _next_due_ns: int | None = None
    _unreadable: set[int] = field(default_factory=set)
    _unreadable_reads: int = 0

    def open(self) -> None:
        """Find the frames.

        Raises:
            AssetError: the folder is no recording.
            CaptureError: it has no such camera, of another size, or without frames.
        """
        camera = self.camera
        recording = open_recording(camera.folder)
        for problem in recording.problems:
            _log.warning("recording is not whole", camera=camera.camera_id, reason=problem)
        names = [track.camera.camera_id for track in recording.tracks]
        if camera.camera_id not in names:
            raise CaptureError(
                f"camera {camera.camera_id}: not in the recording {camera.folder}; there are: {', '.join(names)}"
            )
        index = names.index(camera.camera_id)
        track = recording.tracks[index]
        if (track.camera.height, track.camera.width) != (camera.height, camera.width):
            raise CaptureError(
                f"camera {camera.camera_id}: recorded with {track.camera.width} x {track.camera.height} pixels, "
                f"expected {camera.width} x {camera.height} as the room file says"
            )
        if not track.frames:
            raise CaptureError(
                f"camera {camera.camera_id}: the recording {camera.folder} holds no frame of it"
            )
        timeline = make_timeline(recording.manifest, [other.infos for other in recording.tracks])
        self._track, self._due_ns, self._duration_ns = track, timeline.due_ns[index], timeline.duration_ns
        self._position, self._frame, self._opened_ns = -1, None, None

    def close(self) -> None:
        """Forget the present frame."""
        self._frame = None

    def set_light_weights(self, weights: tuple[float, ...]) -> None:
        """Ignore the switchable lights: a recording shows what it shows."""

    def wait_for_frame(self, stop: threading.Event, period_s: float) -> None:
        """Wait until the next frame is due."""
        wait_s = min(period_s, _MAX_WAIT_S)
        if self._next_due_ns is not None:
            wait_s = min(max((self._next_due_ns - time.monotonic_ns()) * 1e-9, 0.001), _MAX_WAIT_S)
        stop.wait(wait_s)

    def next_frame(self, now_ns: int) -> RawFrame | None:
        """Return the frame that is due; None after the end and where a frame is damaged. Late callers skip frames."""
        track = self._track
        if track is None:
            raise CaptureError(f"camera {self.camera.camera_id}: next_frame before open")
        self._opened_ns = now_ns if self._opened_ns is None else self._opened_ns
        start_ns = self._start_ns(now_ns)
        elapsed_ns = max(0, round((now_ns - start_ns) * self.camera.speed))
        rounds, elapsed_ns = divmod(elapsed_ns, self._duration_ns)
        if rounds and not self.camera.loop:
            self._next_due_ns, self._elapsed_ns = None, self._duration_ns
            return None
        self._elapsed_ns = elapsed_ns
        position = max(0, bisect_right(self._due_ns, elapsed_ns) - 1)
        begin_ns = rounds * self._duration_ns
        following = (
            self._due_ns[position + 1]
            if position + 1 < len(self._due_ns)
            else self._duration_ns + self._due_ns[0]
        )
        self._next_due_ns = start_ns + round((begin_ns + following) / self.camera.speed)
        if position != self._position or rounds != self._rounds:
            due_ns = start_ns + round((begin_ns + self._due_ns[position]) / self.camera.speed)
            self._position, self._rounds = position, rounds
            self._frame = self._read(track, position, min(due_ns, now_ns))
        return self._frame

    def _start_ns(self, now_ns: int) -> int:
        """When the recording begins: not before all processes of the service run."""
        origin_ns = self.camera.origin_ns()
        assert self._opened_ns is not None
        if origin_ns is None:
            return now_ns if now_ns - self._opened_ns < _MAX_HOLD_NS else self._opened_ns + _MAX_HOLD_NS
        return origin_ns or self._opened_ns

    def _read(self, track: Track, position: int, due_ns: int) -> RawFrame | None:
        frame = track.frames[position]
        try:
            pixels = track.read(frame)
        except AssetError as error:
            self._unreadable_reads += 1
            if position not in self._unreadable:
                self._unreadable.add(position)
                _log.warning("frame dropped", camera=self.camera.camera_id, reason=str(error))
            return None
        self._revision += 1
        return RawFrame(
            pixels=pixels,
            timestamp_ns=due_ns,
            content_revision=self._revision,
            counters={**frame.info.counters, "unreadable_files": self._unreadable_reads},
            metadata={
                **frame.info.metadata,
                "recorded_sequence": frame.info.sequence,
                "recorded_timestamp_ns": str(frame.info.timestamp_ns),
            },
        )

    def describe(self) -> dict[str, str | int | float | bool]:
        """Describe the source for the status page."""
        return {
            "kind": "recording",
            "folder": self.camera.folder.resolve().name,
            "frames": len(self._due_ns),
            "position_s": round(self._elapsed_ns * 1e-9, 2),
            "duration_s": round(self._duration_ns * 1e-9, 2),
            "speed": self.camera.speed,
            "loop": self.camera.loop,
            "unreadable_files": self._unreadable_reads,
        }
