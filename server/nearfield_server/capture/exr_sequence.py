"""A recorded camera: a folder of OpenEXR frames, played at a set rate or at the recorded times."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass, field
from pathlib import Path

import structlog

from nearfield_server.capture.source import RawFrame, wait_for_period
from nearfield_server.errors import AssetError, CaptureError
from nearfield_server.scene.exr import read_exr

INDEX_NAME = "index.jsonl"

_log = structlog.get_logger("nearfield.capture")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExrSequence:
    """A recording.

    `index.jsonl` in the folder is optional: one JSON object per line, `{"file": "000001.exr", "timestamp_ns": "123"}`, times as
    strings because other tools read JSON numbers as doubles; a last line that is cut off is passed over. Without an index every `*.exr`
    is played in the order of the names.

    Attributes:
        camera_id: name for messages.
        folder: where the frames are.
        frame_rate: frames per second when there is no index.
        height: pixels expected. width: pixels expected.
        loop: start again after the last frame; otherwise the source falls silent.
    """

    camera_id: str
    folder: Path
    frame_rate: float
    height: int
    width: int
    loop: bool = True


def _read_index(sequence: ExrSequence) -> list[tuple[Path, int]]:
    """Files and their times in ns from the first one."""
    index_path = sequence.folder / INDEX_NAME
    if not index_path.exists():
        period_ns = 1e9 / sequence.frame_rate
        return [
            (path, round(number * period_ns))
            for number, path in enumerate(sorted(sequence.folder.glob("*.exr")))
        ]
    entries: list[tuple[Path, int]] = []
    lines = index_path.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True)
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            record = json.loads(line)
            name, timestamp_ns = record["file"], int(record["timestamp_ns"])
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            if number == len(lines) and not line.endswith("\n"):
                _log.warning("index ends in the middle of a line", file=str(index_path), line=number)
                break
            raise AssetError(
                f'{index_path}:{number}: expected {{"file": name, "timestamp_ns": "digits"}}, found {line[:80]!r}'
            ) from error
        if not isinstance(name, str) or Path(name).name != name:
            raise AssetError(f"{index_path}:{number}: {name!r} is not the name of a file in the folder")
        if entries and timestamp_ns <= entries[-1][1]:
            raise AssetError(
                f"{index_path}:{number}: time {timestamp_ns} does not follow {entries[-1][1]}; times must ascend"
            )
        entries.append((sequence.folder / name, timestamp_ns))
    first = entries[0][1] if entries else 0
    return [(path, timestamp_ns - first) for path, timestamp_ns in entries]


@dataclass(slots=True)
class ExrSequenceSource:
    """`Source` of a recording. A frame that cannot be read is dropped, counted and told once; the recording goes on."""

    sequence: ExrSequence
    _entries: list[tuple[Path, int]] = field(default_factory=list)
    _start_ns: int | None = None
    _position: int = -1
    _frame: RawFrame | None = None
    _revision: int = 0
    _unreadable: set[Path] = field(default_factory=set)
    _unreadable_reads: int = 0

    def open(self) -> None:
        """Read the list of frames.

        Raises:
            AssetError: the index is malformed.
            CaptureError: the folder is missing or empty.
        """
        if not self.sequence.folder.is_dir():
            raise CaptureError(
                f"camera {self.sequence.camera_id}: folder {self.sequence.folder} of the recording does not exist"
            )
        self._entries = _read_index(self.sequence)
        if not self._entries:
            raise CaptureError(f"camera {self.sequence.camera_id}: no *.exr in {self.sequence.folder}")
        self._start_ns, self._position = None, -1

    def close(self) -> None:
        """Forget the present frame."""
        self._frame = None

    def set_light_weights(self, weights: tuple[float, ...]) -> None:
        """Ignore the switchable lights: a recording shows what it shows."""

    def wait_for_frame(self, stop: threading.Event, period_s: float) -> None:
        """Wait for the next period."""
        wait_for_period(stop, period_s)

    def next_frame(self, now_ns: int) -> RawFrame | None:
        """Return the frame that is due; None after the end and where a frame is unreadable. Late callers skip frames."""
        if not self._entries:
            raise CaptureError(f"camera {self.sequence.camera_id}: next_frame before open")
        if self._start_ns is None:
            self._start_ns = now_ns
        elapsed_ns = now_ns - self._start_ns
        last_ns = self._entries[-1][1]
        duration_ns = last_ns + self._last_period_ns()
        if elapsed_ns >= duration_ns:
            if not self.sequence.loop:
                return None
            elapsed_ns %= duration_ns
        position = max(index for index, (_, due_ns) in enumerate(self._entries) if due_ns <= elapsed_ns)
        if position != self._position:
            self._position = position
            self._frame = self._read(self._entries[position][0], now_ns)
        return self._frame

    def _last_period_ns(self) -> int:
        if len(self._entries) < 2:
            return round(1e9 / self.sequence.frame_rate)
        return self._entries[-1][1] - self._entries[-2][1]

    def _read(self, path: Path, now_ns: int) -> RawFrame | None:
        expected = (self.sequence.height, self.sequence.width)
        try:
            pixels = read_exr(path)
            if pixels.shape[:2] != expected or pixels.shape[2] < 3:
                raise AssetError(f"{path}: picture of shape {pixels.shape}, expected {(*expected, 3)}")
        except AssetError as error:
            self._unreadable_reads += 1
            if path not in self._unreadable:
                self._unreadable.add(path)
                _log.warning("frame dropped", camera=self.sequence.camera_id, reason=str(error))
            return None
        self._revision += 1
        # Further channels of a recording (depth, masks) are no validity; only RGB is taken.
        return RawFrame(
            pixels=pixels[..., :3],
            timestamp_ns=now_ns,
            content_revision=self._revision,
            counters={"unreadable_files": self._unreadable_reads},
        )

    def describe(self) -> dict[str, str | int | float | bool]:
        """Describe the source for the status page."""
        return {
            "kind": "exr",
            "folder": self.sequence.folder.name,
            "frames": len(self._entries),
            "loop": self.sequence.loop,
            "unreadable_files": self._unreadable_reads,
        }
