"""From a device's clock to CLOCK_MONOTONIC of this machine, by the lower envelope of arrival over device time.

A picture arrives some delay after the device stamped it, and the delay is never below that of an empty way: no jitter makes a picture
early. So the line on which the earliest arrivals lie is the relation of the two clocks, and what arrives late says nothing. The line is
the solution of a linear program: as high as possible at the mean device time of the window, and above no point. It runs along an edge of
the lower convex hull, the one that spans the mean. (M. Moon, P. Skelly, D. Towsley: Estimation and removal of clock skew from network
delay measurements, 1999.) What remains is the constant delay of an empty way.

Hulls of blocks of the window are kept, not its points: the hull of the hulls is the hull of all points, at a few dozen of them.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

Point = tuple[float, float]
"""(device time, arrival minus device time), both relative to the first picture, seconds."""

WINDOW_S: Final = 60.0
MAX_SKEW: Final = 1e-3
"""Quartz clocks keep 1e-4; more is no clock, but a stamp that does not count time."""
_BLOCKS: Final = 12
_EARLY_S: Final = 5e-3
"""A picture that is so much earlier than any delay allows: the device's clock was set forward."""
_LATE_S: Final = 5e-3
_LATE_FOR_S: Final = 2.0
_LATE_PICTURES: Final = 20
"""All pictures for so long so late: it was set back."""
_HOPELESS_S: Final = 1.0
_SETTLED_S: Final = 10.0
_YOUNG_SKEW: Final = 1e-4
"""In the first seconds jitter tilts the line more than any clock: until then it is as steep as clocks usually are, at most."""
_HELD_SKEW: Final = 2e-5
"""After a jump the oscillator is still the same: until the new window is long enough the skew stays this close to the one before."""
_WRAP_TICKS_NS: Final = (1, 8, 10, 100, 1000)
_WRAPS_NS: Final = tuple(tick << 32 for tick in _WRAP_TICKS_NS)
_WRAP_TOLERANCE_S: Final = 0.25


def append_to_hull(hull: list[Point], point: Point) -> None:
    """Add a point to the right of all others to a lower convex hull, which stays one (Andrew's monotone chain).

    Args:
        hull: points by ascending x, changed in place.
        point: with x above that of the last one.
    """
    while len(hull) >= 2:
        (x0, y0), (x1, y1) = hull[-2], hull[-1]
        if (y1 - y0) * (point[0] - x0) < (point[1] - y0) * (x1 - x0):
            break
        hull.pop()
    hull.append(point)


def supporting_line(
    hull: Sequence[Point], mean_x: float, least_slope: float, greatest_slope: float
) -> tuple[float, float]:
    """Return the line above no point of a lower hull that is highest at `mean_x`, among the slopes allowed.

    Args:
        hull: at least one point, by ascending x.
        mean_x: between the first and the last x.
        least_slope: smallest slope allowed.
        greatest_slope: largest slope allowed.

    Returns:
        (slope, height at x = 0).
    """
    right = next((index for index, (x, _) in enumerate(hull) if x >= mean_x), len(hull) - 1)
    slope = 0.0
    if right > 0:
        (x0, y0), (x1, y1) = hull[right - 1], hull[right]
        slope = (y1 - y0) / (x1 - x0)
    # With one slope fixed the highest line below all points touches the hull; heights are concave in the slope, so clamping is optimal.
    slope = min(max(slope, least_slope), greatest_slope)
    return slope, min(y - slope * x for x, y in hull)


@dataclass(slots=True)
class _Block:
    """The hull of consecutive points, and what is needed for their mean."""

    start_s: float
    hull: list[Point] = field(default_factory=list)
    sum_x: float = 0.0
    count: int = 0


class ClockMap:
    """Maps one device's clock. Feed it every picture, also those that are not used; pure, the caller brings all times.

    Stamps may be counters of 32 bits (of 1, 8, 10, 100 or 1000 ns): a wrap is told from a clock that was set back by the arrival.

    Attributes:
        jumps: how often the device's clock was set forward or back, or restarted.
        wraps: how often its counter ran over.
    """

    def __init__(self, window_s: float = WINDOW_S, max_skew: float = MAX_SKEW) -> None:
        """Begin without any picture.

        Args:
            window_s: pictures older than this, in device time, are forgotten, in twelve steps.
            max_skew: greatest relative difference between the rates of the clocks.
        """
        self._window_s, self._max_skew = window_s, max_skew
        self.jumps = 0
        self.wraps = 0
        self._known_skew: float | None = None
        self._forget(0, 0)
        self._is_empty = True

    def _forget(self, device_ns: int, arrival_ns: int) -> None:
        self._origin = (device_ns, arrival_ns)
        self._wrapped_ns = 0
        self._blocks: deque[_Block] = deque()
        self._closed: list[Point] = []
        self._last_x = float("-inf")
        self._last_arrival_ns = arrival_ns
        self._slope, self._height = self._known_skew or 0.0, 0.0
        self._late: list[
            float
        ] = []  # device times of pictures that came late, without a punctual one between

    @property
    def span_s(self) -> float:
        """Device time that the window covers at present."""
        return self._last_x - self._blocks[0].start_s if self._blocks else 0.0

    @property
    def skew_ppm(self) -> float:
        """How many microseconds the host's clock gains on the device's in a second."""
        return 1e6 * self._slope

    def restart(self) -> None:
        """Forget the relation of the clocks, as after the device was opened again, but not the skew that was found."""
        self._is_empty = True

    def observe(self, device_ns: int, arrival_ns: int) -> int:
        """Take one picture.

        Args:
            device_ns: the device's time of an event at a fixed time before the picture is sent, best the end of its exposure: the
                line is drawn through the pictures with the shortest time from this event to their arrival.
            arrival_ns: CLOCK_MONOTONIC when it had arrived; never before that of the picture before.

        Returns:
            CLOCK_MONOTONIC of the event, ns, never after `arrival_ns`; later by the constant delay of an empty way.
        """
        if self._is_empty:
            self._forget(device_ns, arrival_ns)
            self._is_empty = False
        self._unwrap(device_ns, arrival_ns)
        x, y = self._point(device_ns, arrival_ns)
        if self._has_jumped(x, y - (self._height + self._slope * x)):
            if self.span_s >= 1.0:
                self.jumps += 1
            self._forget(device_ns, arrival_ns)
            x, y = 0.0, 0.0
        self._add(x, y)
        self._last_arrival_ns = arrival_ns
        self._fit()
        return self.to_host_ns(device_ns)

    def to_host_ns(self, device_ns: int) -> int:
        """Return CLOCK_MONOTONIC of a device time near the newest picture (to the counter's wrap before it), ns."""
        unwrapped = device_ns - self._origin[0] + self._wrapped_ns
        offset_s = self._height + self._slope * (unwrapped * 1e-9)
        return self._origin[1] + unwrapped + round(offset_s * 1e9)

    def _point(self, device_ns: int, arrival_ns: int) -> Point:
        unwrapped = device_ns - self._origin[0] + self._wrapped_ns
        return unwrapped * 1e-9, (arrival_ns - self._origin[1] - unwrapped) * 1e-9

    def _residual_s(self, device_ns: int, arrival_ns: int) -> float:
        x, y = self._point(device_ns, arrival_ns)
        return y - (self._height + self._slope * x)

    def _unwrap(self, device_ns: int, arrival_ns: int) -> None:
        if self._point(device_ns, arrival_ns)[0] >= self._last_x:
            return
        silence_ns = arrival_ns - self._last_arrival_ns
        for wrap_ns in _WRAPS_NS:
            count = round(self._residual_s(device_ns, arrival_ns) * 1e9 / wrap_ns)
            late_s = self._residual_s(device_ns + count * wrap_ns, arrival_ns)
            # A long silence may hide several wraps; nothing else does.
            if 1 <= count <= 1 + silence_ns // wrap_ns and -_EARLY_S < late_s < _WRAP_TOLERANCE_S:
                self._wrapped_ns += count * wrap_ns
                self.wraps += count
                return

    def _has_jumped(self, x: float, late_s: float) -> bool:
        if not self._blocks:
            return False
        if x <= self._last_x or late_s < -_EARLY_S or late_s > _HOPELESS_S:
            return True
        if late_s < _LATE_S:
            self._late.clear()
            return False
        self._late.append(x)
        return len(self._late) >= _LATE_PICTURES and x - self._late[0] >= _LATE_FOR_S

    def _add(self, x: float, y: float) -> None:
        length_s = self._window_s / _BLOCKS
        if not self._blocks or x >= self._blocks[-1].start_s + length_s:
            self._blocks.append(_Block(x))
            while len(self._blocks) > 1 and self._blocks[1].start_s < x - self._window_s:
                self._blocks.popleft()
            self._closed = []
            for block in list(self._blocks)[:-1]:
                for point in block.hull:
                    append_to_hull(self._closed, point)
        block = self._blocks[-1]
        append_to_hull(block.hull, (x, y))
        block.sum_x += x
        block.count += 1
        self._last_x = x

    def _fit(self) -> None:
        hull = self._closed.copy()
        for point in self._blocks[-1].hull:
            append_to_hull(hull, point)
        mean_x = sum(block.sum_x for block in self._blocks) / sum(block.count for block in self._blocks)
        is_settled = self.span_s >= min(_SETTLED_S, 0.5 * self._window_s)
        if is_settled:
            likely, around = 0.0, self._max_skew
        elif self._known_skew is not None:
            likely, around = self._known_skew, _HELD_SKEW
        else:
            likely, around = 0.0, min(_YOUNG_SKEW, self._max_skew)
        self._slope, self._height = supporting_line(hull, mean_x, likely - around, likely + around)
        if is_settled:
            self._known_skew = self._slope


def shared_clock_offset(
    device_ns: int,
    arrival_ns: int,
    *,
    monotonic_ns: Callable[[], int] = time.monotonic_ns,
    read_clock: Callable[[int], int] = time.clock_gettime_ns,
) -> int | None:
    """What to add to the time of a device that is synchronised by PTP to get CLOCK_MONOTONIC, if this machine keeps the same time.

    Where the grandmaster follows or leads one of the host's clocks (CLOCK_TAI as PTP has it, or CLOCK_REALTIME as software time stamping
    often gives), no fit is needed and no constant delay remains.

    Args:
        device_ns: the device's time of the end of the exposure.
        arrival_ns: CLOCK_MONOTONIC when the picture had arrived.
        monotonic_ns: CLOCK_MONOTONIC.
        read_clock: any clock of the system.

    Returns:
        The offset, ns; None where the picture would have arrived before it was exposed, or more than a second after, by either clock:
        the time is that of another grandmaster, and `ClockMap` serves.
    """
    for clock in (time.CLOCK_REALTIME, getattr(time, "CLOCK_TAI", 11)):
        offset = monotonic_ns() - read_clock(clock)
        if -1_000_000 <= arrival_ns - (device_ns + offset) <= 1_000_000_000:
            return offset
    return None
