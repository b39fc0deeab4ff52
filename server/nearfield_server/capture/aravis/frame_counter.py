"""Frame numbers that count on for ever, and how many pictures were lost between whole ones. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

_LARGEST_SHORT_ID: Final = 0xFFFF  # GigE Vision 1: 16 bits, 0 is not used: 65535 is followed by 1


def id_step(last: int, current: int) -> int | None:
    """How many pictures further `current` is than `last`; None if the device has begun to count anew.

    Short ids (16 bit) wrap from 65535 to 1. A step back over more than half of their range is no wrap. Longer ids never wrap.

    Args:
        last: id before, as the device sent it.
        current: id now, likewise.
    """
    if current > last:
        return current - last
    if last > _LARGEST_SHORT_ID or last == current:
        return None
    step = current - last + _LARGEST_SHORT_ID
    return step if step <= _LARGEST_SHORT_ID // 2 else None


@dataclass(slots=True)
class FrameCounter:
    """Counts whole, broken and lost pictures of one device.

    Broken pictures may come without their id, so they are counted, and taken from the gap between the whole ones around them.

    Attributes:
        received: whole pictures.
        broken: pictures of which a part was missing.
        lost: pictures of which nothing came.
    """

    received: int = 0
    broken: int = 0
    lost: int = 0
    _frame_id: int = 0
    _last: int | None = None
    _broken_since: int = 0

    def whole(self, device_id: int) -> int:
        """Count a whole picture; returns its id, unwrapped: later pictures have greater ones, and a gap is a loss."""
        step = None if self._last is None else id_step(self._last, device_id)
        if step is None:  # the first one, or the device counts anew: what was lost in between is not known
            step = 1 + self._broken_since
        self.lost += max(step - 1 - self._broken_since, 0)
        self._frame_id += max(step, 1)
        self._last, self._broken_since = device_id, 0
        self.received += 1
        return self._frame_id

    def incomplete(self) -> None:
        """Count a broken picture."""
        self.broken += 1
        self._broken_since += 1

    def restarted(self) -> None:
        """Expect the device to count anew: its stream was stopped and started."""
        self._last, self._broken_since = None, 0
