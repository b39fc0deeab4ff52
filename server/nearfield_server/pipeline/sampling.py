"""Importance sampling of the direct atlas (Rohmer et al. 2014, section 4.3): density proportional to direct L dA.

The pattern is stratified and fixed, so equal input gives equal samples. The cumulative sum is float64: in float32 up to
99 % of the texels of a room with one bright lamp would never be chosen. Only blocks that reach the threshold are read.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.pipeline.blocks import BLOCK, BlockPool, direct_blocks, num_chunks_for

_BLOCKS_PER_CHUNK: Final = 2048
"""A thread is woken in the time that this many blocks take."""


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
    chunk: int, first: int, last: int, blocks: Any, radiance: Any, area: Any, threshold: Any, weights: Any
) -> None:
    for k in range(first, last):
        total = 0.0
        for texel in range(blocks[k] * BLOCK, min((blocks[k] + 1) * BLOCK, area.shape[0])):
            total += direct_weight(radiance, area, threshold, texel)
        weights[k] = total


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _pick(
    radiance: Any,
    area: Any,
    threshold: Any,
    blocks: Any,
    block_first: Any,
    positions: Any,
    owner: Any,
    samples: Any,
) -> None:
    """Walk through the blocks once: positions increase, so a sample goes on where the one before stopped."""
    chosen, texel, before, newest = -1, 0, 0.0, -1
    for k in range(positions.shape[0]):
        block = blocks[owner[k]]
        if newest != block:
            newest, chosen, texel, before = block, -1, block * BLOCK, 0.0
        rest = positions[k] - block_first[owner[k]]
        stop = min((block + 1) * BLOCK, area.shape[0])
        while texel < stop:
            weight = direct_weight(radiance, area, threshold, texel)
            if weight > 0.0:
                # Rounding may leave a rest behind the last texel: then the last one with weight is meant.
                chosen = texel
                if rest < before + weight:
                    break
                before += weight
            texel += 1
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
    blocks = direct_blocks(block_max, threshold)
    weights = np.zeros(blocks.size)
    pool.run(
        _block_weights,
        blocks.size,
        blocks,
        radiance,
        area,
        threshold,
        weights,
        num_chunks=num_chunks_for(blocks.size, _BLOCKS_PER_CHUNK),
    )
    cumulative = np.cumsum(weights)
    total = float(cumulative[-1]) if cumulative.size else 0.0
    if not total > 0.0:
        return np.zeros(0, dtype=np.int64), 0.0
    positions = pattern * total
    owner = np.searchsorted(cumulative, positions, side="right")
    # A position rounded up to the total belongs to the last block that has weight.
    owner = np.minimum(owner, np.flatnonzero(weights)[-1])
    samples = np.empty(pattern.shape[0], dtype=np.int64)
    _pick(radiance, area, threshold, blocks, cumulative - weights, positions, owner, samples)
    return samples, total
