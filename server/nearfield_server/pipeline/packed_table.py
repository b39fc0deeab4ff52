"""The gather table in the layouts that devices read: 12 bytes per pair of a texel and a camera.

Instead of two fractions and a weight each pair holds the four weights of its 2x2 pixels. They are relative: the reader divides by
their sum over the valid pixels. The largest weight of each texel is 2^15, so that a pixel used as it is comes out bit for bit, and the
rounding of the others changes the radiance by less than 2^-15 of the contrast between the pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import ConfigError
from nearfield_server.pipeline.blocks import BLOCK
from nearfield_server.records import GatherTable

MAX_CAMERAS: Final = 16
MAX_PIXELS: Final = 1 << 26
"""Of one picture: six bits of a pair's 32 name the texel within its block."""
TEXEL_BITS: Final = 6
_LARGEST_TAP: Final = 1 << 15


@dataclass(frozen=True, slots=True, kw_only=True)
class PackedTable:
    """Pairs texel by texel.

    Attributes:
        pair_start: (N + 1,) int64, as in `GatherTable`.
        camera: (P,) uint8. pixel: (P,) uint32, top-left one of 2x2 pixels that all lie in the picture.
        taps: (P, 4) uint16 relative weights: top left, top right, bottom left, bottom right.
        camera_shapes: ((height, width), ...).
    """

    pair_start: NDArray[np.int64]
    camera: NDArray[np.uint8]
    pixel: NDArray[np.uint32]
    taps: NDArray[np.uint16]
    camera_shapes: tuple[tuple[int, int], ...]

    @property
    def num_texels(self) -> int:
        """N."""
        return int(self.pair_start.shape[0]) - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockTable:
    """Pairs block by block, and camera by camera within a block: a kernel stays in one picture for dozens of pairs.

    Attributes:
        segment_start: (B * C + 1,) int64: the pairs of block b and camera c start at `segment_start[b * C + c]`.
        target: (P,) uint32: pixel << TEXEL_BITS | position of the texel in its block.
        taps: (P, 4) uint16 as in `PackedTable`.
        seen: (N,) bool, the texel has pairs.
        camera_shapes: ((height, width), ...), C of them.
    """

    segment_start: NDArray[np.int64]
    target: NDArray[np.uint32]
    taps: NDArray[np.uint16]
    seen: NDArray[np.bool_]
    camera_shapes: tuple[tuple[int, int], ...]

    @property
    def num_blocks(self) -> int:
        """B."""
        return -(-int(self.seen.shape[0]) // BLOCK)


def pack_gather_table(table: GatherTable) -> PackedTable:
    """Turn fractions and weights into four weights per pair. Done once per room.

    A tap on the last column or row is moved one pixel back, so that readers may always read 2x2 pixels.

    Raises:
        ConfigError: more than 16 cameras, a picture smaller than 2x2 or larger than 2^26 pixels, a texel with more than
            255 pairs, or a pair outside its picture.
    """
    _check_table(table)
    shapes = np.array(table.camera_shapes or [(2, 2)], dtype=np.int64)
    height, width = shapes[table.camera.astype(np.int64)].T
    row, column = np.divmod(table.pixel.astype(np.int64), width)
    if np.any(row >= height):
        raise ConfigError("gather table names pixels outside the camera picture; rebuild the table")
    last_column, last_row = column == width - 1, row == height - 1
    right = np.where(last_column, 1.0, table.fraction_x.astype(np.float64))
    down = np.where(last_row, 1.0, table.fraction_y.astype(np.float64))
    pixel = (row - last_row) * width + column - last_column
    taps = np.stack([(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down], axis=1)
    taps *= table.weight.astype(np.float64)[:, None]
    return PackedTable(
        pair_start=table.pair_start,
        camera=table.camera,
        pixel=pixel.astype(np.uint32),
        taps=_quantise(taps, table.pair_start),
        camera_shapes=table.camera_shapes,
    )


def _check_table(table: GatherTable) -> None:
    shapes = table.camera_shapes
    if len(shapes) > MAX_CAMERAS:
        raise ConfigError(f"the room has {len(shapes)} cameras, at most {MAX_CAMERAS} are supported")
    for index, shape in enumerate(shapes):
        if min(shape) < 2 or shape[0] * shape[1] > MAX_PIXELS:
            raise ConfigError(
                f"camera {index} delivers {shape[1]}x{shape[0]} pixels; expected 2x2 up to 2^26 pixels"
            )
    counts = np.diff(table.pair_start)
    if counts.size and (counts.min() < 0 or counts.max() > 255):
        raise ConfigError(
            f"gather table: a texel has {counts.max()} pairs (min {counts.min()}), expected 0 to 255"
        )
    if table.camera.size and table.camera.max() >= len(shapes):
        raise ConfigError(
            f"gather table names camera {table.camera.max()}, but there are {len(shapes)}; rebuild the table"
        )


def _quantise(taps: NDArray[np.float64], pair_start: NDArray[np.int64]) -> NDArray[np.uint16]:
    """(P, 4) uint16, in proportion within each texel."""
    counts = np.diff(pair_start)
    filled = np.flatnonzero(counts)
    largest = taps.max(axis=1)
    if filled.size == 0:
        return np.zeros((0, 4), dtype=np.uint16)
    of_texel = np.repeat(np.maximum.reduceat(largest, pair_start[filled]), counts[filled])
    scaled = np.rint(taps * (_LARGEST_TAP / of_texel)[:, None])
    # A camera of tiny weight must still count where all the others are blind.
    scaled[np.arange(largest.size), taps.argmax(axis=1)] += scaled.max(axis=1) == 0.0
    return scaled.astype(np.uint16)


def repeat_pairs(table: GatherTable, texels: NDArray[np.int32], sources: NDArray[np.int32]) -> GatherTable:
    """The table in which some texels without pairs (U,) have those of other texels (U,), and so show the same radiance."""
    counts = np.diff(table.pair_start)
    origin = np.arange(counts.size)
    origin[texels] = sources
    start = np.concatenate([[0], np.cumsum(counts[origin])]).astype(np.int64)
    pairs = np.repeat(table.pair_start[:-1][origin] - start[:-1], counts[origin]) + np.arange(start[-1])
    return replace(
        table,
        pair_start=start,
        camera=table.camera[pairs],
        pixel=table.pixel[pairs],
        fraction_x=table.fraction_x[pairs],
        fraction_y=table.fraction_y[pairs],
        weight=table.weight[pairs],
    )


def group_by_block(table: PackedTable) -> BlockTable:
    """Reorder pairs for the processor's kernel."""
    num_cameras = max(1, len(table.camera_shapes))
    counts = np.diff(table.pair_start)
    texel = np.repeat(np.arange(counts.size), counts)
    segment = (texel // BLOCK) * num_cameras + table.camera
    num_segments = -(-counts.size // BLOCK) * num_cameras
    order = np.argsort(segment, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(segment, minlength=num_segments))])
    target = (table.pixel.astype(np.uint32) << np.uint32(TEXEL_BITS)) | (texel % BLOCK).astype(np.uint32)
    return BlockTable(
        segment_start=starts.astype(np.int64),
        target=np.ascontiguousarray(target[order]),
        taps=np.ascontiguousarray(table.taps[order]),
        seen=counts > 0,
        camera_shapes=table.camera_shapes,
    )
