"""Choice of the split threshold from the atlas itself, without a ratio.

Differs from the paper: Rohmer et al. 2014 fix the share of direct light (75 to 98 %). Emitters hold anything from a few to
over eighty per cent of the light of a room, and every ordinary lit surface that is pressed into a few VALs costs accuracy.
Here the threshold is put into a gap of the histogram of log radiance, weighted by L dA: the lowest gap above which only
sources lie. Sources are told by three properties of the texels above the gap: they are much brighter than the rest, they
cover little of the room (a source that covers much of it is low-frequency light, which the SH carry well), and hardly any
energy lies within the gap, because reflecting surfaces shade smoothly into each other. Otsu's criterion (1979), which
takes the best single cut, loses the weaker of two sources of different radiance, and splits a room without any source.

A lamp's bright spot in a dark room has these properties too. The caller can tell it by geometry (`reflections`): the lowest
classes are left out while they are only reflections of those above.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.pipeline.levels import LEVEL_SHIFT, LEVELS

_LEVELS_PER_OCTAVE: Final = 1 << (23 - LEVEL_SHIFT)
_GAP: Final = 5
"""Half width of a gap in levels: a factor 1.24 to either side."""


_NEW_LIGHT: Final = 0.03
"""Relative change of sum L dA beyond which the light is another one; noise of the cameras averages to far less."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Limits:
    """What a cut must satisfy.

    Attributes:
        min_share: least share of the energy that a class of sources holds.
        max_gap: largest energy within the gap, relative to the smaller neighbour.
        max_area: largest share of the room's area that all sources together cover.
        min_contrast: least ratio of the mean radiance of all sources to that of the rest.
    """

    min_share: float
    max_gap: float
    max_area: float
    min_contrast: float


_STRICT: Final = _Limits(min_share=0.01, max_gap=0.1, max_area=0.15, min_contrast=3.0)
# A threshold in use is judged more kindly, so that noise moves nothing.
_KIND: Final = _Limits(min_share=0.005, max_gap=0.2, max_area=0.18, min_contrast=2.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Levels:
    """Histogram of one channel on 16 levels per octave, padded so that gaps at its ends exist.

    Cut i puts levels i and above on the direct side.

    Attributes:
        radiance: (n,) lower edge of each level.
        energy_above: (n,) share of sum L dA at and above each level. area_above: the same for the area.
        gap_energy: (n,) share of the energy within `_GAP` levels of each cut.
        contrast: (n,) mean radiance above over mean radiance below each cut.
    """

    radiance: NDArray[np.float64]
    energy_above: NDArray[np.float64]
    area_above: NDArray[np.float64]
    gap_energy: NDArray[np.float64]
    contrast: NDArray[np.float64]


ReflectionTest = Callable[[int, float, float, float, float], bool]
"""Whether a class of texels only reflects the classes above it: (channel, radiance of the upper cut, radiance of the lower
cut, sum L dA above the upper cut in W/sr, area above it in m^2)."""


class AutoSplit:
    """The threshold from update to update: steady under noise, chosen anew when the light of the room has changed."""

    def __init__(self) -> None:
        self._threshold = np.full(3, np.inf, dtype=np.float32)
        self._chosen_at = np.zeros(3)
        # Radiance of cuts that were refused or believed in the present light, per channel.
        self._refused: list[list[float]] = [[], [], []]
        self._believed: list[list[float]] = [[], [], []]

    def choose(
        self,
        histogram: NDArray[np.int64],
        scale: float,
        total_area: float,
        is_reflected: ReflectionTest | None = None,
    ) -> NDArray[np.float32]:
        """(3,) float32 threshold; first arguments as for `auto_threshold`.

        A channel whose total differs from that at which its threshold was chosen forgets it: a cut that was right with a
        lamp off can lie among the surfaces that the lamp lights.

        Args:
            histogram: see `auto_threshold`.
            scale: see `auto_threshold`.
            total_area: see `auto_threshold`.
            is_reflected: asked once per class and light; without it every class counts as a source.
        """
        total = histogram.sum(axis=1).astype(np.float64) / scale
        changed = np.abs(total - self._chosen_at) > _NEW_LIGHT * self._chosen_at
        previous = np.where(changed, np.float32(np.inf), self._threshold)
        threshold = np.full(3, np.inf, dtype=np.float32)
        for channel in range(3):
            if changed[channel]:
                self._refused[channel], self._believed[channel] = [], []
            levels = _levels(histogram[channel], scale * total_area)
            if levels is not None:
                energy = float(total[channel]), total_area
                cuts = self._sources(channel, levels, _source_cuts(levels), *energy, is_reflected)
                threshold[channel] = _keep_or_choose(levels, cuts, float(previous[channel]))
        anew = changed | (threshold != self._threshold)
        self._chosen_at = np.where(anew, total, self._chosen_at)
        self._threshold = threshold
        return threshold

    def _sources(
        self,
        channel: int,
        levels: _Levels,
        cuts: list[int],
        total: float,
        total_area: float,
        is_reflected: ReflectionTest | None,
    ) -> list[int]:
        """The cuts without the lowest classes that only reflect; what lies between two sources stays with them."""
        while is_reflected is not None and len(cuts) > 1:
            lower, upper = cuts[-1], cuts[-2]
            cut = float(levels.radiance[lower])
            if any(_is_same_cut(cut, believed) for believed in self._believed[channel]):
                break
            if not any(_is_same_cut(cut, refused) for refused in self._refused[channel]):
                above = (
                    float(levels.energy_above[upper]) * total,
                    float(levels.area_above[upper]) * total_area,
                )
                if not is_reflected(channel, float(levels.radiance[upper]), cut, *above):
                    self._believed[channel].append(cut)
                    break
                self._refused[channel].append(cut)
            cuts = cuts[:-1]
        return cuts


def auto_threshold(
    histogram: NDArray[np.int64], scale: float, total_area: float, previous: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Threshold per channel that leaves sources direct and ordinary lit surfaces indirect.

    Args:
        histogram: (3, bins) int64 sums of L dA by the upper bits of the radiance: `levels.LEVELS` bins, or a multiple of them.
        scale: by which L dA was multiplied.
        total_area: of all texels, m^2, black ones included.
        previous: (3,) thresholds in use; each stays while it still splits well and no further source has appeared.

    Returns:
        (3,) float32; infinity for a channel that is black or in which no source stands out.
    """
    threshold = np.full(3, np.inf, dtype=np.float32)
    for channel in range(3):
        levels = _levels(histogram[channel], scale * total_area)
        if levels is not None:
            old = np.inf if previous is None else float(previous[channel])
            threshold[channel] = _keep_or_choose(levels, _source_cuts(levels), old)
    return threshold


def _levels(histogram: NDArray[np.int64], scaled_area: float) -> _Levels | None:
    energy = histogram.reshape(LEVELS, -1).sum(axis=1).astype(np.float64)
    used = np.flatnonzero(energy)
    if used.size == 0:
        return None
    # Room for a whole empty gap below the lowest level: in a black room the sources are all there is.
    first, last = max(int(used[0]) - 2 * _GAP, 0), int(used[-1]) + _GAP + 1
    energy = energy[first:last]
    level = np.arange(first, last, dtype=np.uint32)
    radiance = (level << np.uint32(LEVEL_SHIFT)).view(np.float32).astype(np.float64)
    middle = (
        ((level << np.uint32(LEVEL_SHIFT)) | np.uint32(1 << (LEVEL_SHIFT - 1)))
        .view(np.float32)
        .astype(np.float64)
    )
    # Black texels lie below all levels: areas are shares of the whole room. Rounding must not make more than that.
    area = energy / middle / scaled_area
    area /= max(1.0, float(area.sum()))
    energy /= energy.sum()
    below = np.concatenate([[0.0], np.cumsum(energy)])
    energy_above = np.cumsum(energy[::-1])[::-1]
    area_above = np.cumsum(area[::-1])[::-1]
    cut = np.arange(level.size)
    gap = below[np.minimum(cut + _GAP, level.size)] - below[np.maximum(cut - _GAP, 0)]
    tiny = 1e-12  # far below any share that counts, and its inverse still multiplies
    contrast = (energy_above / np.maximum(area_above, tiny)) * (
        np.maximum(1.0 - area_above, 0.0) / np.maximum(1.0 - energy_above, tiny)
    )
    return _Levels(
        radiance=radiance, energy_above=energy_above, area_above=area_above, gap_energy=gap, contrast=contrast
    )


def _keep_or_choose(levels: _Levels, cuts: list[int], previous: float) -> float:
    """The threshold in use while it still splits well and no further source has appeared, else the lowest cut."""
    if np.isfinite(previous):
        kept = int(np.searchsorted(levels.radiance, previous))
        in_range = 0 < kept < levels.radiance.size
        if in_range and _separates(levels, kept, 0.0, _KIND):
            if not cuts:
                return previous
            newly_direct = levels.energy_above[cuts[-1]] - levels.energy_above[kept]
            if newly_direct < _STRICT.min_share:
                return previous
    return float(levels.radiance[cuts[-1]]) if cuts else float("inf")


def _source_cuts(levels: _Levels) -> list[int]:
    """All gaps that separate a class of sources from what is below it, from the top."""
    cuts: list[int] = []
    above = 0.0
    cut = levels.radiance.size - 1
    while cut > 0 and levels.area_above[cut] <= _STRICT.max_area:
        if _separates(levels, cut, above, _STRICT):
            cut = _middle_of_gap(levels.gap_energy, cut)
            cuts.append(cut)
            above = float(levels.energy_above[cut])
        cut -= 1
    return cuts


def _is_same_cut(cut: float, other: float) -> bool:
    """Whether two cuts lie in one gap: noise moves the emptiest place of a gap, never beyond its width."""
    return abs(math.log2(cut / other)) * _LEVELS_PER_OCTAVE <= 2 * _GAP


def _separates(levels: _Levels, cut: int, above: float, limits: _Limits) -> bool:
    """Whether a cut splits a class of sources off; `above` is the energy of the classes above it."""
    own = levels.energy_above[cut] - above
    # Behind the sources there may be little light, as in a black room; the gap is then judged against the sources alone.
    rest = max(1.0 - levels.energy_above[cut], limits.min_share)
    return bool(
        own >= limits.min_share
        and levels.gap_energy[cut] <= limits.max_gap * min(own, rest)
        and levels.area_above[cut] <= limits.max_area
        and levels.contrast[cut] >= limits.min_contrast
    )


def _middle_of_gap(gap_energy: NDArray[np.float64], cut: int) -> int:
    """Slide down to the emptiest cut of this gap; the middle where several are equally empty."""
    lowest = cut
    while lowest > 1 and gap_energy[lowest - 1] < gap_energy[lowest]:
        lowest -= 1
    end = lowest
    while end > 1 and gap_energy[end - 1] == gap_energy[lowest]:
        end -= 1
    return (lowest + end) // 2
