"""Gather: camera pictures to radiance per texel (Rohmer et al. 2014, section 4.1) through a precomputed table.

Differs from the paper: projection, visibility and the blend weights of all cameras are static and live in the table, so
an update only reads the pixels that matter. The energy of each level of radiance, which the split needs, is counted on the way, while
the radiance is still in registers.

Whole and partial updates run the same instructions on each block, and the energies are integers, so that they leave the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.errors import ConfigError
from nearfield_server.pipeline.blocks import BLOCK, FASTMATH, BlockPool
from nearfield_server.pipeline.levels import LEVEL_SHIFT, LEVELS, energy_scale
from nearfield_server.pipeline.packed_table import TEXEL_BITS, BlockTable
from nearfield_server.pipeline.vector_ops import (
    ACCUMULATOR_BYTES,
    TAP_BYTES,
    accumulate_pair,
    take_blend,
    to_fixed_point,
)
from nearfield_server.radiometry.half import float_bits, prefetch

_PIXEL_BYTES: Final = 8
_RADIANCE_BYTES: Final = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Atlas:
    """Radiance of all texels and what is known about it. The arrays are written to by the stages that own it.

    Attributes:
        radiance: (N, 3) float32 >= 0, with four readable bytes behind it (`black_atlas`).
        block_max: (B, 3) float32, largest radiance of each block.
        energy: (3, LEVELS) int64, sum of L dA by level of radiance, times `energy_scale`.
        energy_scale: power of two, see `levels.energy_scale`.
        area: (N,) float32 m^2.
    """

    radiance: NDArray[np.float32]
    block_max: NDArray[np.float32]
    energy: NDArray[np.int64]
    energy_scale: float
    area: NDArray[np.float32]


def black_atlas(area: NDArray[np.float32]) -> Atlas:
    """An atlas of (N,) texels without light."""
    num_blocks = -(-area.shape[0] // BLOCK)
    return Atlas(
        # One float more than needed: the kernel reads four floats per texel.
        radiance=np.zeros(3 * area.shape[0] + 1, dtype=np.float32)[:-1].reshape(-1, 3),
        block_max=np.zeros((num_blocks, 3), dtype=np.float32),
        energy=np.zeros((3, LEVELS), dtype=np.int64),
        energy_scale=energy_scale(area),
        area=area,
    )


def frame_pointers(
    frames: Sequence[NDArray[np.float16] | None], camera_shapes: Sequence[tuple[int, int]]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Addresses (0 = no picture) and row strides in bytes of all camera pictures.

    The arrays must stay alive and unchanged while a kernel uses the addresses.

    Raises:
        ConfigError: the number of pictures, a shape, the type or the memory layout is wrong.
    """
    if len(frames) != len(camera_shapes):
        raise ConfigError(
            f"expected {len(camera_shapes)} camera pictures (None where missing), found {len(frames)}"
        )
    address = np.zeros(max(1, len(frames)), dtype=np.int64)
    stride = np.zeros(max(1, len(frames)), dtype=np.int64)
    for index, (pixels, shape) in enumerate(zip(frames, camera_shapes, strict=True)):
        if pixels is None:
            continue
        if pixels.shape != (*shape, 4) or pixels.dtype != np.float16 or not pixels.flags.c_contiguous:
            raise ConfigError(
                f"camera {index}: expected a contiguous float16 picture {(*shape, 4)}, found {pixels.dtype} {pixels.shape}"
            )
        address[index] = pixels.ctypes.data
        stride[index] = shape[1] * _PIXEL_BYTES
    return address, stride


@njit(cache=True, nogil=True, fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def _accumulate_block(
    block: int,
    after: int,
    num_cameras: int,
    segment_start: Any,
    target: Any,
    tap_address: int,
    address: Any,
    stride: Any,
    accumulators: int,
) -> None:
    """Add up the pixels of all cameras, and ask for those of the block that comes `after`."""
    for camera in range(num_cameras):
        first = segment_start[block * num_cameras + camera]
        last = segment_start[block * num_cameras + camera + 1]
        base, pitch = address[camera], stride[camera]
        if base == 0:
            continue
        # The pixels of the next block of the same camera: far enough ahead for memory, and lower rows come as upper ones.
        ahead = segment_start[after * num_cameras + camera]
        ahead_last = segment_start[after * num_cameras + camera + 1]
        for k in range(np.uintp(first), np.uintp(last)):
            if ahead < ahead_last:
                prefetch(base + np.int64(target[np.uintp(ahead)] >> np.uint32(TEXEL_BITS)) * _PIXEL_BYTES)
                ahead += 1
            pair = target[k]
            upper = base + np.int64(pair >> np.uint32(TEXEL_BITS)) * _PIXEL_BYTES
            slot = np.int64(pair & np.uint32(BLOCK - 1))
            accumulate_pair(
                upper,
                upper + pitch,
                tap_address + np.int64(k) * TAP_BYTES,
                accumulators + slot * ACCUMULATOR_BYTES,
            )


@njit(cache=True, nogil=True, inline="always")  # type: ignore[untyped-decorator]
def _count_energy(energy: Any, red: Any, green: Any, blue: Any, weight: float, sign: int) -> None:
    amounts = to_fixed_point(red, green, blue, weight)
    # Unsigned: numba tests signed indices for being negative, which would cost as much as the rest.
    energy[0, np.uintp(float_bits(red) >> np.uint32(LEVEL_SHIFT))] += sign * amounts[0]
    energy[1, np.uintp(float_bits(green) >> np.uint32(LEVEL_SHIFT))] += sign * amounts[1]
    energy[2, np.uintp(float_bits(blue) >> np.uint32(LEVEL_SHIFT))] += sign * amounts[2]


@njit(cache=True, nogil=True, fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def _gather_blocks(
    chunk: int,
    first: int,
    last: int,
    blocks: Any,
    num_cameras: int,
    segment_start: Any,
    target: Any,
    taps: Any,
    seen: Any,
    address: Any,
    stride: Any,
    area: Any,
    scale: float,
    is_partial: bool,
    radiance: Any,
    block_max: Any,
    changed: Any,
    energy: Any,
    scratch: Any,
) -> None:
    # The caller owns this memory: an array made here would be freed as soon as only its address is used.
    accumulators = (scratch.ctypes.data + ACCUMULATOR_BYTES - 1) // ACCUMULATOR_BYTES * ACCUMULATOR_BYTES
    accumulators += chunk * BLOCK * ACCUMULATOR_BYTES
    tap_address, radiance_address = taps.ctypes.data, radiance.ctypes.data
    levels = energy[chunk]
    for position in range(first, last):
        block = blocks[position]
        after = blocks[min(position + 1, last - 1)]
        _accumulate_block(
            block, after, num_cameras, segment_start, target, tap_address, address, stride, accumulators
        )
        high0, high1, high2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        change = np.uint8(0)
        first_texel = np.uintp(block * BLOCK)
        for slot in range(np.uintp(min(BLOCK, area.shape[0] - block * BLOCK))):
            texel = first_texel + slot
            old0, old1, old2 = radiance[texel, 0], radiance[texel, 1], radiance[texel, 2]
            if seen[texel]:
                new0, new1, new2, differs = take_blend(
                    accumulators + np.int64(slot) * ACCUMULATOR_BYTES,
                    radiance_address + np.int64(texel) * _RADIANCE_BYTES,
                )
                change |= differs
                weight = np.float64(area[texel]) * scale
                if not is_partial:
                    _count_energy(levels, new0, new1, new2, weight, 1)
                elif differs:
                    _count_energy(levels, old0, old1, old2, weight, -1)
                    _count_energy(levels, new0, new1, new2, weight, 1)
                old0, old1, old2 = new0, new1, new2
            high0, high1, high2 = max(high0, old0), max(high1, old1), max(high2, old2)
        block_max[block, 0], block_max[block, 1], block_max[block, 2] = high0, high1, high2
        changed[block] = change != 0


def gather(
    table: BlockTable,
    frames: Sequence[NDArray[np.float16] | None],
    atlas: Atlas,
    pool: BlockPool,
    *,
    blocks: NDArray[np.int32] | None = None,
) -> NDArray[np.bool_]:
    """Blend the pictures of all cameras into radiance per texel.

    Invalid pixels (alpha 0) and missing cameras are left out and the other weights are renormalised; a texel that no valid
    pixel shows gets 0. Texels without pairs are left as they are.

    Args:
        table: gather table by blocks.
        frames: per camera (H, W, 4) float16, or None.
        atlas: updated.
        pool: threads.
        blocks: increasing numbers of the only blocks whose pixels may differ from those of the last call; None: all.

    Returns:
        (B,) bool: blocks in which the radiance of a texel is another one than before.

    Raises:
        ConfigError: pictures do not fit the table.
    """
    address, stride = frame_pointers(frames, table.camera_shapes)
    changed = np.zeros(table.num_blocks, dtype=np.bool_)
    is_partial = blocks is not None
    chosen = np.arange(table.num_blocks, dtype=np.int32) if blocks is None else blocks
    num_chunks = 1 if chosen.size < 2 * pool.num_threads else pool.num_threads
    energy = np.zeros((num_chunks, 3, LEVELS), dtype=np.int64)
    # One accumulator more, for aligning the first.
    scratch = np.zeros((num_chunks * BLOCK + 1) * ACCUMULATOR_BYTES // 4, dtype=np.float32)
    pool.run(
        _gather_blocks,
        chosen.size,
        chosen,
        len(table.camera_shapes),
        table.segment_start,
        table.target,
        table.taps,
        table.seen,
        address,
        stride,
        atlas.area,
        atlas.energy_scale,
        is_partial,
        atlas.radiance,
        atlas.block_max,
        changed,
        energy,
        scratch,
        num_chunks=num_chunks,
    )
    total = energy.sum(axis=0)
    if is_partial:
        total += atlas.energy
    atlas.energy[...] = total
    return changed


def block_maxima(radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    """(B, 3) largest radiance per block, for radiance that was not made by `gather`."""
    return np.maximum.reduceat(radiance, np.arange(0, radiance.shape[0], BLOCK), axis=0)
