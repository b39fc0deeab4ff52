"""Choice of the split threshold from the atlas itself, without a ratio.

Differs from the paper: Rohmer et al. 2014 fix the share of direct light (75 to 98 %). Emitters hold anything from a few to
over eighty per cent of the light of a room, and every ordinary lit surface that is pressed into a few VALs costs accuracy.
Here the threshold separates two populations in the histogram of log radiance, weighted by L dA (Otsu 1979).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

_KEEP_SCORE: Final = 0.97
"""A previous threshold stays in use while its score is at least this share of the best one."""
_MIN_CONTRAST: Final = 2.0
"""Sources shine at least this many times brighter than the light that they are told from (geometric means)."""


def bin_edges(bins: NDArray[np.integer]) -> NDArray[np.float64]:
    """Lower edge of histogram bins, radiance."""
    return (bins.astype(np.uint32) << np.uint32(16)).view(np.float32).astype(np.float64)


def auto_threshold(
    histogram: NDArray[np.int64], previous: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Threshold per channel by the between-class variance of log radiance.

    Args:
        histogram: (3, split.COARSE_BINS) int64 of `split.radiance_histogram`.
        previous: (3,) threshold in use, kept where it is nearly as good, so that noise moves nothing.

    Returns:
        (3,) float32; infinity for a channel that is black.
    """
    threshold = np.full(3, np.inf, dtype=np.float32)
    for channel in range(3):
        old = None if previous is None else float(previous[channel])
        threshold[channel] = _channel_threshold(histogram[channel], old)
    return threshold


def _channel_threshold(histogram: NDArray[np.int64], previous: float | None) -> float:
    used = np.flatnonzero(histogram)
    if used.size == 0:
        return float("inf")
    lower, upper = bin_edges(used), bin_edges(used + 1)
    if used.size == 1:
        return float(lower[0])
    weight = histogram[used].astype(np.float64)
    weight /= weight.sum()
    level = np.log2(0.5 * (lower + upper))
    score = _between_class(weight, level)
    best = int(np.argmax(score))
    if previous is not None and np.isfinite(previous):
        kept = int(np.searchsorted(lower, previous)) - 1
        if 0 <= kept < score.size and score[kept] >= _KEEP_SCORE * score[best]:
            return previous
    # Between two populations there is a gap: the middle of the widest empty stretch among nearly equal scores.
    good = np.flatnonzero(score >= _KEEP_SCORE * score[best])
    gap = np.log2(lower[good + 1] / upper[good])
    cut = int(good[np.argmax(gap)])
    return float(np.float32(np.sqrt(upper[cut] * lower[cut + 1])))


def _between_class(weight: NDArray[np.float64], level: NDArray[np.float64]) -> NDArray[np.float64]:
    """Otsu's score of a cut after each bin but the last."""
    below = np.cumsum(weight)[:-1]
    moment = np.cumsum(weight * level)
    above = np.maximum(1.0 - below, 1e-300)
    difference = moment[:-1] / below - (moment[-1] - moment[:-1]) / above
    return np.asarray(below * above * difference * difference)
