"""How the clock of another machine relates to ours, from questions and answers; with bounds, not with hope.

We ask at `asked`, it receives at `received` and answers at `answered` (its clock), we hear that at `heard`. Nothing travels back in
time, so our clock minus its clock lies between `asked - received` and `heard - answered`, whatever the network did and however
lopsided it is. Several exchanges narrow the interval down; older ones are widened by how far two clocks can drift apart meanwhile.
The estimate is the middle of the interval, half its width the greatest error.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

# Crystal clocks are within 100 ppm of true each; a clock that NTP slews may be 500 ppm off for a while.
DRIFT_LIMIT = 600e-6
_WINDOW = 64


@dataclass(frozen=True, slots=True)
class _Bounds:
    since_ns: int
    low_ns: int
    high_ns: int


@dataclass(slots=True)
class ClockExchange:
    """Offset between two CLOCK_MONOTONIC. Pure: the caller brings the times, all in nanoseconds.

    Attributes:
        restarts: how often exchanges contradicted each other, because a clock jumped (a machine slept); the newest then counts alone.
    """

    restarts: int = 0
    _bounds: deque[_Bounds] = field(default_factory=lambda: deque(maxlen=_WINDOW))

    def add(self, asked_ns: int, received_ns: int, answered_ns: int, heard_ns: int) -> bool:
        """Add one exchange; false (and nothing added) if it is impossible."""
        if heard_ns < asked_ns or answered_ns < received_ns:
            return False
        low, high = asked_ns - received_ns, heard_ns - answered_ns
        # It claims to have thought about the answer for longer than the whole exchange took.
        if high + 2 * _drift(heard_ns - asked_ns) < low:
            return False
        # It was true at some moment since the question.
        self._bounds.append(_Bounds(asked_ns, low, high))
        if self._interval(heard_ns) is None:
            self.restarts += 1
            newest = self._bounds[-1]
            self._bounds.clear()
            self._bounds.append(newest)
        return True

    def clear(self) -> None:
        """Forget everything: it is another clock now."""
        self._bounds.clear()

    def offset(self, now_ns: int) -> tuple[int, int] | None:
        """Return (ours minus theirs, greatest error) in nanoseconds, or None before the first exchange.

        Args:
            now_ns: our clock.
        """
        interval = self._interval(now_ns)
        if interval is None:
            return None
        low, high = interval
        return (low + high) // 2, (high - low + 1) // 2

    def _interval(self, now_ns: int) -> tuple[int, int] | None:
        """What all exchanges allow; None if there is none, or if they contradict each other."""
        if not self._bounds:
            return None
        low = max(b.low_ns - _drift(now_ns - b.since_ns) for b in self._bounds)
        high = min(b.high_ns + _drift(now_ns - b.since_ns) for b in self._bounds)
        return (low, high) if low <= high else None


def _drift(age_ns: int) -> int:
    # One more nanosecond for the rounding of offsets to whole ones.
    return int(max(age_ns, 0) * DRIFT_LIMIT) + 1
