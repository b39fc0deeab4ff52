"""Gather: camera pictures to radiance per texel (Rohmer et al. 2014, section 4.1) through a precomputed table.

Differs from the paper: projection, visibility and the blend weights of all cameras are static and live in the table, so
an update only reads the pixels that matter.
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
from nearfield_server.radiometry.half import FRACTION_STEPS, accumulate_taps, prefetch
from nearfield_server.records import GatherTable

_CAMERA_SHIFT: Final = 60
_PIXEL_SHIFT: Final = 32
_PIXEL_MASK: Final = (1 << 28) - 1
MAX_CAMERAS: Final = 16
_PIXEL_BYTES: Final = 8
_AHEAD: Final = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class PackedTable:
    """The gather table in 8 bytes per pair.

    Attributes:
        pairs: (P,) uint64: camera (4 bits), top-left pixel (28), fraction x (8), fraction y (8), weight (16). Fractions are
            n / 255; weights are relative, the kernel divides by their sum over the valid pixels.
        pair_count: (N,) uint8, pairs per texel.
        block_pair_start: (B + 1,) int64, first pair of each block.
        camera_shapes: ((height, width), ...).
    """

    pairs: NDArray[np.uint64]
    pair_count: NDArray[np.uint8]
    block_pair_start: NDArray[np.int64]
    camera_shapes: tuple[tuple[int, int], ...]


def pack_gather_table(table: GatherTable) -> PackedTable:
    """Pack a gather table for the kernel. Done once per room.

    A tap on the last column or row is moved one pixel back with fraction 1, so that the kernel may always read 2x2 pixels.

    Raises:
        ConfigError: more than 16 cameras, a picture smaller than 2x2 or larger than 2^28 pixels, a texel with more than
            255 pairs, or a pair outside its picture.
    """
    shapes = table.camera_shapes
    if len(shapes) > MAX_CAMERAS:
        raise ConfigError(f"the room has {len(shapes)} cameras, at most {MAX_CAMERAS} are supported")
    for index, shape in enumerate(shapes):
        if min(shape) < 2 or shape[0] * shape[1] > _PIXEL_MASK:
            raise ConfigError(
                f"camera {index} delivers {shape[1]}x{shape[0]} pixels; expected 2x2 up to 2^28 pixels"
            )
    counts = np.diff(table.pair_start)
    if counts.size and (counts.min() < 0 or counts.max() > 255):
        raise ConfigError(
            f"gather table: a texel has {counts.max()} pairs (min {counts.min()}), expected 0 to 255"
        )
    camera = table.camera.astype(np.int64)
    if camera.size and camera.max() >= len(shapes):
        raise ConfigError(
            f"gather table names camera {camera.max()}, but there are {len(shapes)}; rebuild the table"
        )
    height = np.array([shape[0] for shape in shapes] or [0], dtype=np.int64)[camera]
    width = np.array([shape[1] for shape in shapes] or [0], dtype=np.int64)[camera]
    row, column = np.divmod(table.pixel.astype(np.int64), np.maximum(width, 1))
    if np.any(row >= height):
        raise ConfigError("gather table names pixels outside the camera picture; rebuild the table")
    fraction_x = np.rint(table.fraction_x.astype(np.float64) * FRACTION_STEPS).astype(np.int64)
    fraction_y = np.rint(table.fraction_y.astype(np.float64) * FRACTION_STEPS).astype(np.int64)
    last_column, last_row = column == width - 1, row == height - 1
    column, fraction_x = (
        np.where(last_column, column - 1, column),
        np.where(last_column, FRACTION_STEPS, fraction_x),
    )
    row, fraction_y = np.where(last_row, row - 1, row), np.where(last_row, FRACTION_STEPS, fraction_y)
    weight = np.clip(np.rint(table.weight.astype(np.float64) * 65535.0), 1, 65535).astype(np.int64)
    pairs = camera.astype(np.uint64) << np.uint64(_CAMERA_SHIFT)
    pairs |= (row * width + column).astype(np.uint64) << np.uint64(_PIXEL_SHIFT)
    pairs |= ((fraction_x << 24) | (fraction_y << 16) | weight).astype(np.uint64)
    starts = np.append(table.pair_start[:-1][::BLOCK], table.pair_start[-1]).astype(np.int64)
    return PackedTable(
        pairs=pairs, pair_count=counts.astype(np.uint8), block_pair_start=starts, camera_shapes=shapes
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
def _gather_blocks(
    chunk: int,
    first: int,
    last: int,
    pairs: Any,
    pair_count: Any,
    block_pair_start: Any,
    address: Any,
    stride: Any,
    radiance: Any,
    block_max: Any,
) -> None:
    for block in range(first, last):
        k = block_pair_start[block]
        high0, high1, high2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        stop = min((block + 1) * BLOCK, pair_count.shape[0])
        for texel in range(block * BLOCK, stop):
            total = (np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0))
            for _ in range(pair_count[texel]):
                if k + _AHEAD < pairs.shape[0]:
                    ahead = pairs[k + _AHEAD]
                    camera = np.int64(ahead >> np.uint64(_CAMERA_SHIFT))
                    row0 = (
                        address[camera]
                        + (np.int64(ahead >> np.uint64(_PIXEL_SHIFT)) & _PIXEL_MASK) * _PIXEL_BYTES
                    )
                    prefetch(row0)
                    prefetch(row0 + stride[camera])
                pair = pairs[k]
                k += 1
                camera = np.int64(pair >> np.uint64(_CAMERA_SHIFT))
                base = address[camera]
                if base != 0:
                    row0 = base + (np.int64(pair >> np.uint64(_PIXEL_SHIFT)) & _PIXEL_MASK) * _PIXEL_BYTES
                    low = np.uint32(pair & np.uint64(0xFFFFFFFF))
                    fraction_x = np.float32(low >> np.uint32(24))
                    fraction_y = np.float32((low >> np.uint32(16)) & np.uint32(255))
                    weight = np.float32(low & np.uint32(0xFFFF))
                    total = accumulate_taps(
                        row0, row0 + stride[camera], fraction_x, fraction_y, weight, total
                    )
            scale = np.float32(0.0)
            if total[3] > np.float32(0.0):
                scale = np.float32(1.0) / total[3]
            value0, value1, value2 = total[0] * scale, total[1] * scale, total[2] * scale
            radiance[texel, 0], radiance[texel, 1], radiance[texel, 2] = value0, value1, value2
            high0, high1, high2 = max(high0, value0), max(high1, value1), max(high2, value2)
        block_max[block, 0], block_max[block, 1], block_max[block, 2] = high0, high1, high2


def gather(
    table: PackedTable,
    frames: Sequence[NDArray[np.float16] | None],
    radiance: NDArray[np.float32],
    block_max: NDArray[np.float32],
    pool: BlockPool,
    *,
    fill_texels: NDArray[np.int32] | None = None,
    fill_sources: NDArray[np.int32] | None = None,
) -> None:
    """Blend the pictures of all cameras into radiance per texel.

    Invalid pixels (alpha 0) and missing cameras are left out and the other weights are renormalised; a texel that no valid
    pixel shows gets 0, unless `fill_texels` names it: then it repeats the radiance of its entry in `fill_sources`.

    Args:
        table: packed gather table.
        frames: per camera (H, W, 4) float16, or None.
        radiance: (N, 3) float32, overwritten.
        block_max: (B, 3) float32, overwritten with the largest radiance of each block.
        pool: threads.
        fill_texels: (U,) positions in texel order without any pair.
        fill_sources: (U,) positions that have pairs.

    Raises:
        ConfigError: pictures do not fit the table.
    """
    address, stride = frame_pointers(frames, table.camera_shapes)
    pool.run(
        _gather_blocks,
        block_max.shape[0],
        table.pairs,
        table.pair_count,
        table.block_pair_start,
        address,
        stride,
        radiance,
        block_max,
    )
    if fill_texels is not None and fill_sources is not None:
        _fill(fill_texels, fill_sources, radiance, block_max)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _fill(texels: Any, sources: Any, radiance: Any, block_max: Any) -> None:
    for k in range(texels.shape[0]):
        texel, source = texels[k], sources[k]
        for channel in range(3):
            value = radiance[source, channel]
            radiance[texel, channel] = value
            block = texel // BLOCK
            block_max[block, channel] = max(block_max[block, channel], value)


def block_maxima(radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    """(B, 3) largest radiance per block, for radiance that was not made by `gather`."""
    return np.maximum.reduceat(radiance, np.arange(0, radiance.shape[0], BLOCK), axis=0)
