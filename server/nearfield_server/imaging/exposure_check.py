"""Exposures compared by their pixels: the ratio of two exposures from what both of them measured.

Pixels count where the longer exposure measured well: not saturated, and bright enough that the shorter one still shows some codes. The
choice looks at the longer exposure alone, so that noise of the shorter one cannot bias it. Sums over blocks give a ratio each; where
most of them agree lies the answer, so that it does not follow a lamp that was switched, or a person who walked, between the two exposures.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

_BLOCK_ROWS = 8
_BLOCK_COLUMNS = 32
_LEAST_PIXELS = 24
_LEAST_BLOCKS = 4
_WELL_MEASURED = (0.25, 0.06, 0.015)
_LEAST_STEPS = 4.0
_SPREAD = 4.0
_LEAST_SPREAD = 0.002


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _block_sums(
    longer: NDArray[np.uint16],
    shorter: NDArray[np.uint16],
    lookup: NDArray[np.float32],
    saturated_from: int,
    least: float,
    sums: NDArray[np.float64],
) -> None:
    """Sums (rows of blocks, columns of blocks, 3) of the signals of both, and the number of pixels."""
    least_signal = np.float32(least)
    for row in range(longer.shape[0]):
        for column in range(longer.shape[1]):
            code = longer[row, column]
            signal = lookup[code]
            if code < saturated_from and signal >= least_signal and shorter[row, column] < saturated_from:
                block = sums[row // _BLOCK_ROWS, column // _BLOCK_COLUMNS]
                block[0] += signal
                block[1] += lookup[shorter[row, column]]
                block[2] += 1.0


def exposure_ratio(
    first: NDArray[np.uint16],
    second: NDArray[np.uint16],
    lookup: NDArray[np.float32],
    saturated_from: int,
    step: float,
) -> float:
    """Ratio of the exposure amount of the first picture to that of the second.

    Args:
        first: (H, W) uint16 codes of a picture, or of some of its rows (three channels side by side count as columns).
        second: (H, W) likewise, of the same rows.
        lookup: (65536,) float32, signal of a code, see `response`.
        saturated_from: the least code that is no measurement.
        step: signal of one code at the dark end.

    Returns:
        The ratio; NaN if too few pixels are valid in both.
    """
    totals = [
        float(np.take(lookup, np.minimum(codes[::4, ::5], saturated_from)).sum()) for codes in (first, second)
    ]
    is_first_longer = totals[0] >= totals[1]
    longer, shorter = (first, second) if is_first_longer else (second, first)
    blocks = -(-first.shape[0] // _BLOCK_ROWS), -(-first.shape[1] // _BLOCK_COLUMNS)
    top = float(lookup[saturated_from])
    for share in _WELL_MEASURED:
        sums = np.zeros((*blocks, 3))
        _block_sums(longer, shorter, lookup, saturated_from, share * top, sums)
        flat = sums.reshape(-1, 3)
        # Below a few codes the lower end of the converter and its steps bend what the shorter exposure says.
        usable = flat[(flat[:, 2] >= _LEAST_PIXELS) & (flat[:, 1] > _LEAST_STEPS * step * flat[:, 2])]
        ratio = _agreed_ratio(usable)
        if math.isfinite(ratio):
            return ratio if is_first_longer else 1.0 / ratio
    return math.nan


def _agreed_ratio(sums: NDArray[np.float64]) -> float:
    """Ratio of sums over the blocks (n, 3) that agree; NaN if there are too few.

    The narrowest interval that holds half of the pixels tells where they agree; unlike a median it does not lean towards blocks in which
    the light changed. Blocks near it count, so that in a still scene all do.
    """
    if len(sums) < _LEAST_BLOCKS:
        return math.nan
    ratios = np.log(sums[:, 0] / sums[:, 1])
    order = np.argsort(ratios)
    ratios, pixels = ratios[order], sums[order, 2]
    before = np.concatenate(([0.0], np.cumsum(pixels)))
    # For each block as the lower end, the first one with which half of the pixels are reached.
    last = np.searchsorted(before, before[:-1] + 0.5 * before[-1]) - 1
    lower = np.flatnonzero(last < len(ratios))
    widths = ratios[last[lower]] - ratios[lower]
    best = int(np.argmin(widths))
    low, high = ratios[lower[best]], ratios[last[lower[best]]]
    agreed = np.abs(ratios - 0.5 * (low + high)) <= max(_SPREAD * 0.5 * (high - low), _LEAST_SPREAD)
    total = sums[order][agreed].sum(0)
    return float(total[0] / total[1])
