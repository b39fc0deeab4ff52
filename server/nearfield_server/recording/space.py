"""How much room a recording needs and has."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

DEFAULT_RESERVE_BYTES: Final = 500_000_000
_RESERVE_SECONDS: Final = 10.0
_RESERVE_SHARE: Final = 0.05
_LOOK_EVERY_BYTES: Final = 64_000_000
_LOOK_EVERY_S: Final = 0.25
_WINDOW_S: Final = 5.0


@dataclass(frozen=True, slots=True)
class DiskSpace:
    """Bytes of a file system: `free` for this user, `total` in all."""

    free: int
    total: int


def disk_space(folder: Path) -> DiskSpace:
    """Look at the file system of a folder, or of its nearest parent that exists."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    found = os.statvfs(folder)
    return DiskSpace(free=found.f_bavail * found.f_frsize, total=found.f_blocks * found.f_frsize)


def most_bytes_per_second(sizes: Sequence[tuple[int, int]], frame_rate: float) -> float:
    """What cameras of these (height, width) deliver when every picture is another one, before compression."""
    return sum(height * width * 8 for height, width in sizes) * frame_rate


TYPICAL_RATIO: Final = 0.4
"""Size on disk relative to that: fish-eye pictures with noise, either format."""


class WriteRate:
    """Bytes per second over the last seconds."""

    def __init__(self) -> None:
        self._written: deque[tuple[float, int]] = deque()

    def add(self, now_s: float, num_bytes: int) -> None:
        """Count what was written."""
        self._written.append((now_s, num_bytes))
        self._forget(now_s)

    def per_second(self, now_s: float) -> float:
        """Mean over the last five seconds, or since the first bytes."""
        self._forget(now_s)
        if not self._written:
            return 0.0
        span_s = max(now_s - self._written[0][0], 0.5)
        return sum(size for _, size in self._written) / span_s

    def _forget(self, now_s: float) -> None:
        while self._written and now_s - self._written[0][0] > _WINDOW_S:
            self._written.popleft()


class SpaceGuard:
    """Says when to stop, so that the disk never fills up: others need it too, and files that do not fit are lost work.

    Args:
        folder: of the recording.
        reserve_bytes: what must stay free, at the least; None = half a gigabyte, on a small disk a twentieth of it.
        look: how to look at the disk.
    """

    def __init__(
        self,
        folder: Path,
        reserve_bytes: int | None = None,
        look: Callable[[Path], DiskSpace] = disk_space,
    ) -> None:
        self._folder, self._look_at = folder, look
        self._lock = threading.Lock()
        self._space = look(folder)
        self._since_look = 0
        self._looked_s = float("-inf")
        self._reserve = (
            min(DEFAULT_RESERVE_BYTES, int(_RESERVE_SHARE * self._space.total))
            if reserve_bytes is None
            else reserve_bytes
        )
        self._is_default = reserve_bytes is None

    def reserve(self, bytes_per_second: float) -> int:
        """What must stay free at this rate of writing: ten seconds of it, if that is more."""
        if not self._is_default:
            return self._reserve
        return max(self._reserve, min(int(_RESERVE_SECONDS * bytes_per_second), self._space.total // 10))

    def free(self, now_s: float, just_written: int = 0) -> int:
        """Free bytes; looks at the disk now and then and counts in between."""
        with self._lock:
            self._since_look += just_written
            if now_s - self._looked_s >= _LOOK_EVERY_S or self._since_look >= _LOOK_EVERY_BYTES:
                self._space = self._look_at(self._folder)
                self._looked_s, self._since_look = now_s, 0
            return max(0, self._space.free - self._since_look)

    def is_low(self, now_s: float, bytes_per_second: float) -> bool:
        """Whether it is time to stop."""
        return self.free(now_s) < self.reserve(bytes_per_second)

    def minutes_left(self, now_s: float, bytes_per_second: float) -> float | None:
        """How long the disk lasts; None while nothing is written."""
        if bytes_per_second <= 0.0:
            return None
        return max(0.0, self.free(now_s) - self.reserve(bytes_per_second)) / bytes_per_second / 60.0
