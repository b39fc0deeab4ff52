"""Which exposures a scene needs: a bracket chosen from the histogram of the merged picture.

The shortest exposure keeps the brightest pixel below saturation, the longest one lifts the darkest percentile to a signal that is well
above the noise, and the others lie between them at equal ratios. What cannot be seen is found by steps: while pixels are saturated in every
exposure the shortest one shrinks, the faster the more there are; while the dark is lost in noise the longest one grows.

The bright end comes first: lamps carry the light. Where the exposures are too few for the whole range, the dark end is given up, because
light that fills one exposure and is lost in the noise of the next would be missing in the middle.

A plan that is good enough stays: the limits at which it is given up lie a factor of 1.5 and more from where a new plan would put it.
Saturation is answered at once; everything else only when three pictures in a row ask for it, so that a passing shadow changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.errors import ConfigError
from nearfield_server.records import LOWER_BOUND_BITS

BRIGHT_TARGET: Final = 0.6
"""Signal of the brightest pixel in the shortest exposure: where a new plan puts it."""
_BRIGHT_RANGE: Final = (0.1, 0.9)
DARK_TARGET: Final = 0.02
"""Signal of the darkest percentile in the longest exposure: 200 electrons of a full well of 10 000, a signal-to-noise ratio of 14."""
_DARK_RANGE: Final = (0.008, 0.16)
_DARK_SHARE: Final = 0.01
_DARK_FLOOR: Final = 0.002
_STUCK_SHARE: Final = 3e-5
_SHRINK: Final = ((0.05, 64.0), (0.002, 16.0), (0.0, 4.0))
_PATIENCE: Final = 3
_LEAST_RATIO: Final = 2.0
MOST_RATIO: Final = 64.0
"""Between neighbouring exposures: what just fills one still has a signal-to-noise ratio of 12 in the next (a full well of 10 000)."""
_SAME: Final = 0.05
_BIN_SHIFT: Final = 6
_NUM_BINS: Final = 0x8000 >> _BIN_SHIFT


@dataclass(frozen=True, slots=True, kw_only=True)
class RadianceHistogram:
    """How many pixels of a picture have which radiance, by their brightest channel.

    Attributes:
        counts: (512,) int64, measured pixels; bin n holds half floats of bits 64 n to 64 n + 63, that is 16 bins per factor of two.
        num_bounds: pixels of which the radiance is only a lower bound.
    """

    counts: NDArray[np.int64]
    num_bounds: int

    @property
    def num_pixels(self) -> int:
        """Measured pixels and lower bounds."""
        return int(self.counts.sum()) + self.num_bounds

    def quantile(self, share: float) -> float:
        """Radiance below which a share of the pixels lies; lower bounds count as brighter than all others. 0 for a picture of bounds."""
        reached = np.cumsum(self.counts)
        if reached[-1] == 0:
            return 0.0
        rank = min(share * self.num_pixels, float(reached[-1]))
        number = int(np.searchsorted(reached, max(rank, 1.0)))
        return _bin_middle(number)

    @property
    def brightest(self) -> float:
        """Radiance of the brightest measured pixels: those of the fullest end of the histogram, upper edge of their bin."""
        lit = np.flatnonzero(self.counts)
        return _bin_value((int(lit[-1]) + 1) << _BIN_SHIFT) if lit.size else 0.0


def _bin_value(bits: int) -> float:
    return float(np.array(min(bits, 0x7BFF), np.uint16).view(np.float16))


def _bin_middle(number: int) -> float:
    return 0.5 * (_bin_value(number << _BIN_SHIFT) + _bin_value((number + 1) << _BIN_SHIFT))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _count(words: NDArray[np.uint64], circle: NDArray[np.bool_], counts: NDArray[np.int64]) -> int:
    num_bounds = 0
    for row in range(words.shape[0]):
        for column in range(words.shape[1]):
            word = words[row, column]
            alpha = word >> np.uint64(48)
            if (circle.shape[0] != 0 and not circle[row, column]) or alpha == np.uint64(0):
                continue
            if alpha == np.uint64(LOWER_BOUND_BITS):
                num_bounds += 1
                continue
            mask = np.uint64(0xFFFF)
            bits = max(word & mask, word >> np.uint64(16) & mask, word >> np.uint64(32) & mask)
            counts[min(bits >> np.uint64(_BIN_SHIFT), np.uint64(_NUM_BINS - 1))] += 1
    return num_bounds


def radiance_histogram(
    pixels: NDArray[np.float16], circle: NDArray[np.bool_] | None = None
) -> RadianceHistogram:
    """Count the pixels of a picture.

    Args:
        pixels: (H, W, 4) float16, contiguous, finite and >= 0; alpha as in frames: 1, just below 1, or 0.
        circle: (H, W) bool, where the lens shows anything; None = everywhere. What lies outside asks for no exposure.
    """
    counts = np.zeros(_NUM_BINS, np.int64)
    inside = np.zeros((0, 0), np.bool_) if circle is None else circle
    num_bounds = _count(pixels.view(np.uint64)[..., 0], inside, counts)
    return RadianceHistogram(counts=counts, num_bounds=int(num_bounds))


@dataclass(frozen=True, slots=True, kw_only=True)
class BracketLimits:
    """What a bracket may be made of.

    Attributes:
        shortest: exposure amount (seconds times gain), > 0.
        longest: likewise, above `shortest`.
        num_exposures: 2 or more.
        full_radiance: radiance that fills the range at an amount of 1, `radiance_per_code` of the room file.
    """

    shortest: float
    longest: float
    num_exposures: int
    full_radiance: float = 1.0

    def __post_init__(self) -> None:
        if not (0.0 < self.shortest < self.longest < np.inf and self.num_exposures >= 2):
            raise ConfigError(
                "bracket: expected 0 < shortest < longest and two or more exposures, "
                f"found {self.shortest:g}, {self.longest:g} and {self.num_exposures}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class BracketPlan:
    """A bracket, and what is remembered between pictures.

    Attributes:
        amounts: exposure amounts (seconds times gain), the longest first.
        asked: pictures in a row that asked for another plan.
    """

    amounts: tuple[float, ...]
    asked: int = 0


def _spread(longest: float, shortest: float, limits: BracketLimits) -> BracketPlan:
    """Equal ratios between the ends; ends too close to each other are moved apart, the longer one first, ends too far apart together."""
    shortest = min(max(shortest, limits.shortest), limits.longest)
    longest = min(max(longest, limits.shortest), limits.longest)
    apart = _LEAST_RATIO ** (limits.num_exposures - 1)
    longest = min(max(longest, shortest * apart), limits.longest)
    shortest = max(min(shortest, longest / apart), limits.shortest)
    longest = min(longest, shortest * MOST_RATIO ** (limits.num_exposures - 1))
    return BracketPlan(amounts=tuple(np.geomspace(longest, shortest, limits.num_exposures).tolist()))


def first_bracket(limits: BracketLimits) -> BracketPlan:
    """The bracket before anything is known of the scene: all that is allowed."""
    return _spread(limits.longest, limits.shortest, limits)


def plan_bracket(histogram: RadianceHistogram, plan: BracketPlan, limits: BracketLimits) -> BracketPlan:
    """Choose the next bracket from a picture that was merged from the present one.

    Args:
        histogram: of that picture.
        plan: the present one, as this function returned it (devices may have rounded the amounts).
        limits: of device and room file.

    Returns:
        The next plan; its amounts are those of `plan`, unchanged, where these are good enough.
    """
    if histogram.num_pixels == 0:
        return BracketPlan(amounts=plan.amounts)
    longest, shortest = max(plan.amounts), min(plan.amounts)
    bound_share = histogram.num_bounds / histogram.num_pixels
    is_full = bound_share > _STUCK_SHARE
    if is_full:
        # How bright it is nobody knows; the more is full, the further it may be.
        new_shortest = shortest / next(factor for least, factor in _SHRINK if bound_share > least)
        keeps_bright = False
    else:
        bright = histogram.brightest * shortest / limits.full_radiance
        new_shortest = shortest * BRIGHT_TARGET / max(bright, 1e-3)
        keeps_bright = _BRIGHT_RANGE[0] <= bright <= _BRIGHT_RANGE[1]
        is_full = bright > _BRIGHT_RANGE[1]
    dark = histogram.quantile(_DARK_SHARE) * longest / limits.full_radiance
    if histogram.counts.sum() == 0:
        dark = 1.0
    new_longest = longest * DARK_TARGET / max(dark, _DARK_FLOOR)
    keeps_dark = _DARK_RANGE[0] <= dark <= _DARK_RANGE[1]
    better = _spread(
        longest if keeps_dark else new_longest, shortest if keeps_bright else new_shortest, limits
    )
    if all(
        abs(np.log(new / old)) <= _SAME
        for new, old in zip(better.amounts, sorted(plan.amounts, reverse=True), strict=True)
    ):
        # Either both ends are good, or the limits allow nothing better.
        return BracketPlan(amounts=plan.amounts)
    if not is_full and plan.asked + 1 < _PATIENCE:
        return BracketPlan(amounts=plan.amounts, asked=plan.asked + 1)
    return better
