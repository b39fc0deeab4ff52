"""Texels in blocks: the unit of skipping and pruning, and a pool of threads that works through them."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import ConfigError
from nearfield_server.records import TexelGeometry

BLOCK: Final = 64
NORMAL_SCALE: Final = 0.5
"""Metres that a unit difference of normals counts in the cluster distance `|dp|^2 + NORMAL_SCALE^2 |dn|^2`."""

# Partial sums are kept per chunk and added in chunk order, so that results do not depend on the number of threads.
NUM_CHUNKS: Final = 16
FASTMATH: Final = {"reassoc", "contract", "arcp", "nsz"}
"""What kernels may relax. `nnan` and `ninf` are left out: they would delete the tests that keep NaN from spreading."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TexelBlocks:
    """Static per-texel data in kernel layout, with bounds per block of `BLOCK` consecutive texels.

    Attributes:
        position: (N, 3) float32 metres. normal: (N, 3) float32 unit. area: (N,) float32 m^2.
        block_centre: (B, 6) float64, centre of the block in cluster space (position, NORMAL_SCALE * normal).
        block_radius: (B,) float64, all texels of the block lie within this distance of it.
        origin: (3,) float64, a point amid the texels; moments are taken about it to keep their digits.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    area: NDArray[np.float32]
    block_centre: NDArray[np.float64]
    block_radius: NDArray[np.float64]
    origin: NDArray[np.float64]

    @property
    def num_texels(self) -> int:
        """N."""
        return int(self.area.shape[0])

    @property
    def num_blocks(self) -> int:
        """B = ceil(N / BLOCK)."""
        return int(self.block_radius.shape[0])


def make_blocks(texels: TexelGeometry) -> TexelBlocks:
    """Copy texel geometry into kernel layout and bound the blocks.

    Raises:
        ConfigError: there are no texels, an area is negative, or a value is not finite.
    """
    position = np.array(texels.position, dtype=np.float32, order="C")
    normal = np.array(texels.normal, dtype=np.float32, order="C")
    area = np.array(texels.area, dtype=np.float32, order="C")
    if area.size == 0:
        raise ConfigError("the atlas covers no texel; check the UV coordinates of the room model")
    if not (
        np.isfinite(position).all()
        and np.isfinite(normal).all()
        and np.isfinite(area).all()
        and (area >= 0).all()
    ):
        raise ConfigError(
            "texel geometry holds values that are not finite or negative areas; rebuild the atlas"
        )
    features = cluster_features(position, normal)
    starts = np.arange(0, area.size, BLOCK)
    centre = 0.5 * (np.minimum.reduceat(features, starts) + np.maximum.reduceat(features, starts))
    distance = np.linalg.norm(features - np.repeat(centre, BLOCK, axis=0)[: area.size], axis=1)
    return TexelBlocks(
        position=position,
        normal=normal,
        area=area,
        block_centre=centre,
        block_radius=np.maximum.reduceat(distance, starts),
        origin=position.mean(axis=0, dtype=np.float64),
    )


def cluster_features(position: NDArray[np.floating], normal: NDArray[np.floating]) -> NDArray[np.float64]:
    """(..., 6) points of cluster space, in which squared distance is `|dp|^2 + NORMAL_SCALE^2 |dn|^2`."""
    return np.concatenate(
        [np.asarray(position, dtype=np.float64), NORMAL_SCALE * np.asarray(normal, dtype=np.float64)], axis=-1
    )


def direct_blocks(block_max: NDArray[np.float32], threshold: NDArray[np.float32]) -> NDArray[np.int64]:
    """Increasing numbers of the blocks whose (B, 3) maxima reach the (3,) threshold in a channel."""
    # Three long comparisons: numpy reduces a short last axis ten times as slowly.
    reaches = block_max[:, 0] >= threshold[0]
    for channel in (1, 2):
        reaches |= block_max[:, channel] >= threshold[channel]
    return np.flatnonzero(reaches)


def num_chunks_for(num_blocks: int, blocks_per_chunk: int) -> int:
    """Chunks that are worth a job of their own; depends on the number of blocks alone, as the order of sums does."""
    return min(NUM_CHUNKS, 1 + num_blocks // blocks_per_chunk)


class BlockPool:
    """Threads that run a kernel over ranges of blocks.

    Kernels are compiled with `nogil=True` and called as `kernel(chunk, first, last, *arguments)`. Plain threads instead of
    numba's parallel loops: no threading layer to choose, a fraction of the compile time, and safe to call from any thread.
    """

    def __init__(self, num_threads: int | None = None) -> None:
        available = len(os.sched_getaffinity(0)) if num_threads is None else num_threads
        self.num_threads = max(1, min(available, NUM_CHUNKS))
        self._executor = ThreadPoolExecutor(self.num_threads, "light-stage") if self.num_threads > 1 else None

    def run(
        self, kernel: Callable[..., Any], num_items: int, *arguments: object, num_chunks: int = NUM_CHUNKS
    ) -> None:
        """Cover `range(num_items)` with `num_chunks` contiguous chunks and wait for all of them."""
        edges = [num_items * chunk // num_chunks for chunk in range(num_chunks + 1)]
        if self._executor is None or num_chunks == 1:
            for chunk in range(num_chunks):
                kernel(chunk, edges[chunk], edges[chunk + 1], *arguments)
            return
        jobs = [
            self._executor.submit(kernel, chunk, edges[chunk], edges[chunk + 1], *arguments)
            for chunk in range(num_chunks)
        ]
        for job in jobs:
            job.result()

    def close(self) -> None:
        """Stop the threads; the pool must not be used afterwards."""
        if self._executor is not None:
            self._executor.shutdown()
