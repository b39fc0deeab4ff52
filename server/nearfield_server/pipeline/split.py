"""Split of the radiance atlas into direct and indirect light (Rohmer et al. 2014, section 4.2, Eqs. 2 to 4).

A texel's channel is direct where `radiance >= threshold`, per channel. Nothing is materialised: stages that need one part
apply the threshold as they read, so direct + indirect equals the atlas exactly.

The paper compares radiance but builds its histogram over radiant intensity, which agree only for equal texel areas. Here
bins run over radiance and are weighted by L dA. Sums are int64 fixed point: exact, independent of order and thread count.
A threshold of infinity means that nothing is direct.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.pipeline.blocks import BLOCK, BlockPool
from nearfield_server.radiometry.half import float_bits

COARSE_BINS: Final = 1 << 15
"""Bins over the upper 16 bits of a non-negative float32: 128 per octave."""
_FINE_BINS: Final = 1 << 16


def fixed_point_scale(max_radiance: float, total_area: float) -> float:
    """Power of two by which L dA is multiplied before rounding to int64: sums stay below 2^62 and use all of it."""
    bound = max_radiance * total_area
    return 2.0 ** (61 - math.ceil(math.log2(bound))) if bound > 0.0 else 1.0


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _coarse_histogram(
    chunk: int, first: int, last: int, radiance: Any, area: Any, scale: float, bins: Any
) -> None:
    stop = min(last * BLOCK, area.shape[0])
    for texel in range(first * BLOCK, stop):
        weight = np.float64(area[texel]) * scale
        for channel in range(3):
            value = radiance[texel, channel]
            if value > np.float32(0.0):
                energy = np.int64(np.rint(np.float64(value) * weight))
                bins[chunk, channel, np.int64(float_bits(value) >> np.uint32(16))] += energy


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _fine_histogram(
    chunk: int,
    first: int,
    last: int,
    radiance: Any,
    area: Any,
    scale: float,
    coarse: Any,
    block_max: Any,
    bins: Any,
) -> None:
    for block in range(first, last):
        wanted = False
        for channel in range(3):
            high = np.int64(float_bits(block_max[block, channel]) >> np.uint32(16))
            wanted = wanted or (coarse[channel] >= 0 and high >= coarse[channel])
        if not wanted:
            continue
        stop = min((block + 1) * BLOCK, area.shape[0])
        for texel in range(block * BLOCK, stop):
            weight = np.float64(area[texel]) * scale
            for channel in range(3):
                value = radiance[texel, channel]
                bits = float_bits(value)
                if np.int64(bits >> np.uint32(16)) == coarse[channel] and value > np.float32(0.0):
                    energy = np.int64(np.rint(np.float64(value) * weight))
                    bins[chunk, channel, np.int64(bits & np.uint32(0xFFFF))] += energy


def radiance_histogram(
    radiance: NDArray[np.float32], area: NDArray[np.float32], scale: float, num_blocks: int, pool: BlockPool
) -> NDArray[np.int64]:
    """Histogram of radiance, weighted by L dA.

    Args:
        radiance: (N, 3) float32, finite and >= 0.
        area: (N,) m^2.
        scale: of `fixed_point_scale`.
        num_blocks: B.
        pool: threads.

    Returns:
        (3, COARSE_BINS) int64; the bin of a value is its upper 16 bits.
    """
    partial = np.zeros((pool.num_threads, 3, COARSE_BINS), dtype=np.int64)
    pool.run(_coarse_histogram, num_blocks, radiance, area, scale, partial, num_chunks=pool.num_threads)
    return np.asarray(partial.sum(axis=0))


def ratio_threshold(
    radiance: NDArray[np.float32],
    area: NDArray[np.float32],
    block_max: NDArray[np.float32],
    ratio: float,
    pool: BlockPool,
) -> NDArray[np.float32]:
    """Exact threshold per channel: the largest t such that texels with L >= t hold at least `ratio` of sum L dA.

    Args:
        radiance: (N, 3) float32, finite and >= 0.
        area: (N,) m^2.
        block_max: (B, 3).
        ratio: in (0, 1].
        pool: threads.

    Returns:
        (3,) float32: a radiance that occurs in the channel, or infinity where the channel is black.

    Raises:
        ValueError: `ratio` is outside (0, 1].
    """
    if not 0.0 < ratio <= 1.0:
        raise ValueError(f"split ratio must be in (0, 1], found {ratio}")
    num_blocks = block_max.shape[0]
    scale = fixed_point_scale(float(block_max.max(initial=0.0)), float(area.sum(dtype=np.float64)))
    coarse = radiance_histogram(radiance, area, scale, num_blocks, pool)
    bins = np.full(3, -1, dtype=np.int64)
    missing = [0, 0, 0]
    for channel in range(3):
        total = int(coarse[channel].sum())
        if total > 0:
            target = min(math.ceil(ratio * total), total)
            bins[channel], missing[channel] = _crossing(coarse[channel], target)
    fine = np.zeros((pool.num_threads, 3, _FINE_BINS), dtype=np.int64)
    pool.run(
        _fine_histogram, num_blocks, radiance, area, scale, bins, block_max, fine, num_chunks=pool.num_threads
    )
    fine_sum = fine.sum(axis=0)
    threshold = np.full(3, np.inf, dtype=np.float32)
    for channel in range(3):
        if bins[channel] >= 0:
            low, _ = _crossing(fine_sum[channel], missing[channel])
            threshold[channel] = np.array([(int(bins[channel]) << 16) | low], dtype=np.uint32).view(
                np.float32
            )[0]
    return threshold


def _crossing(histogram: NDArray[np.int64], target: int) -> tuple[int, int]:
    """Highest bin at which the sum from above reaches `target`, and what is still missing above that bin's content."""
    from_above = np.cumsum(histogram[::-1])
    index = int(np.searchsorted(from_above, target))
    before = int(from_above[index - 1]) if index else 0
    return histogram.shape[0] - 1 - index, target - before


def direct_totals(
    radiance: NDArray[np.float32], area: NDArray[np.float32], threshold: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sum L dA of the direct part and of everything, (3,) float64 each, W/sr. For reports, not for the fast path."""
    energy = radiance.astype(np.float64) * area.astype(np.float64)[:, None]
    return (energy * (radiance >= threshold)).sum(axis=0), energy.sum(axis=0)
