"""Importance sampling of the direct atlas (Rohmer et al. 2014, section 4.3): density proportional to direct L dA.

The pattern is stratified and fixed, so equal input gives equal samples. The cumulative sum is float64: in float32 up to
99 % of the texels of a room with one bright lamp would never be chosen.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.pipeline.blocks import BLOCK, BlockPool


def stratified_pattern(num_samples: int, seed: int) -> NDArray[np.float64]:
    """(S,) increasing positions in [0, 1), one jittered in each of S equal strata."""
    jitter = np.random.default_rng(seed).random(num_samples)
    return (np.arange(num_samples) + jitter) / num_samples


@njit(cache=True, nogil=True, inline="always")  # type: ignore[untyped-decorator]
def direct_weight(radiance: Any, area: Any, threshold: Any, texel: int) -> float:
    """Grey direct radiant intensity of one texel: sum over the direct channels of L dA / 3."""
    total = 0.0
    for channel in range(3):
        value = radiance[texel, channel]
        if value >= threshold[channel]:
            total += np.float64(value)
    return total * np.float64(area[texel]) / 3.0


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _block_weights(
    chunk: int, first: int, last: int, radiance: Any, area: Any, threshold: Any, block_max: Any, weights: Any
) -> None:
    for block in range(first, last):
        total = 0.0
        if (
            block_max[block, 0] >= threshold[0]
            or block_max[block, 1] >= threshold[1]
            or block_max[block, 2] >= threshold[2]
        ):
            stop = min((block + 1) * BLOCK, area.shape[0])
            for texel in range(block * BLOCK, stop):
                total += direct_weight(radiance, area, threshold, texel)
        weights[block] = total


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _pick(
    radiance: Any, area: Any, threshold: Any, block_first: Any, positions: Any, blocks: Any, samples: Any
) -> None:
    for k in range(positions.shape[0]):
        block = blocks[k]
        rest = positions[k] - block_first[block]
        stop = min((block + 1) * BLOCK, area.shape[0])
        chosen = -1
        for texel in range(block * BLOCK, stop):
            weight = direct_weight(radiance, area, threshold, texel)
            if weight > 0.0:
                # Rounding may leave a rest behind the last texel: then the last one with weight is meant.
                chosen = texel
                if rest < weight:
                    break
                rest -= weight
        samples[k] = chosen


def sample_direct_texels(
    radiance: NDArray[np.float32],
    area: NDArray[np.float32],
    threshold: NDArray[np.float32],
    block_max: NDArray[np.float32],
    pattern: NDArray[np.float64],
    pool: BlockPool,
) -> tuple[NDArray[np.int64], float]:
    """Choose texels by inverse cumulative density.

    Args:
        radiance: (N, 3).
        area: (N,).
        threshold: (3,).
        block_max: (B, 3).
        pattern: (S,) increasing in [0, 1).
        pool: threads.

    Returns:
        (S,) positions in texel order, or (0,) where nothing is direct; and the grey sum of direct L dA, W/sr.
    """
    weights = np.zeros(block_max.shape[0])
    pool.run(_block_weights, weights.shape[0], radiance, area, threshold, block_max, weights)
    cumulative = np.cumsum(weights)
    total = float(cumulative[-1])
    if not total > 0.0:
        return np.zeros(0, dtype=np.int64), 0.0
    positions = pattern * total
    blocks = np.searchsorted(cumulative, positions, side="right")
    # A position rounded up to the total belongs to the last block that has weight.
    blocks = np.minimum(blocks, np.flatnonzero(weights)[-1])
    samples = np.empty(pattern.shape[0], dtype=np.int64)
    _pick(radiance, area, threshold, cumulative - weights, positions, blocks, samples)
    return samples, total
