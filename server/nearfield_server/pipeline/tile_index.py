"""Which blocks of texels show which tiles of which camera picture: the gather table read backwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.pipeline.packed_table import TEXEL_BITS, BlockTable
from nearfield_server.records import FRAME_TILE


@dataclass(frozen=True, slots=True, kw_only=True)
class TileIndex:
    """Blocks by tile. The tiles of all cameras are numbered one after the other, row by row.

    Attributes:
        first_tile: (C + 1,) int64, number of each camera's first tile.
        tile_shapes: ((rows, columns), ...) per camera.
        block_start: (T + 1,) int64: the blocks of tile t are `block[block_start[t]:block_start[t + 1]]`.
        block: int32. A block is named once per tile, and by all four pixels of its pairs, whatever their weight.
    """

    first_tile: NDArray[np.int64]
    tile_shapes: tuple[tuple[int, int], ...]
    block_start: NDArray[np.int64]
    block: NDArray[np.int32]

    def blocks_of(self, tiles: Sequence[NDArray[np.bool_]], num_blocks: int) -> NDArray[np.int32]:
        """Increasing numbers of the blocks that show a marked tile.

        Args:
            tiles: per camera (rows, columns) bool.
            num_blocks: B.
        """
        marked = np.flatnonzero(np.concatenate([tile.reshape(-1) for tile in tiles]))
        touched = np.zeros(num_blocks, dtype=np.bool_)
        _mark(marked, self.block_start, self.block, touched)
        return np.flatnonzero(touched).astype(np.int32)


def index_tiles(table: BlockTable) -> TileIndex:
    """Build the index of a table. Done once per room."""
    shapes = tuple(
        (-(-height // FRAME_TILE), -(-width // FRAME_TILE)) for height, width in table.camera_shapes
    )
    first = np.concatenate([[0], np.cumsum([rows * columns for rows, columns in shapes])]).astype(np.int64)
    widths = np.array([width for _, width in table.camera_shapes], dtype=np.int64)
    columns = np.array([columns for _, columns in shapes], dtype=np.int64)
    count = np.zeros(int(first[-1]) + 1, dtype=np.int64)
    none = np.zeros(0, dtype=np.int32)
    arguments = (table.segment_start, table.target, len(shapes), first, widths, columns)
    _list_blocks(*arguments, False, count, none)
    start = np.concatenate([[0], np.cumsum(count[:-1])]).astype(np.int64)
    block = np.empty(int(start[-1]), dtype=np.int32)
    _list_blocks(*arguments, True, start.copy(), block)
    return TileIndex(first_tile=first, tile_shapes=shapes, block_start=start, block=block)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _list_blocks(
    segment_start: Any,
    target: Any,
    num_cameras: int,
    first_tile: Any,
    widths: Any,
    columns: Any,
    write: bool,
    position: Any,
    block: Any,
) -> None:
    """Count the blocks of each tile in `position`, or write them where `position` points."""
    newest = np.full(first_tile[num_cameras], -1, dtype=np.int64)
    for segment in range(segment_start.shape[0] - 1):
        number, camera = segment // max(num_cameras, 1), segment % max(num_cameras, 1)
        for k in range(segment_start[segment], segment_start[segment + 1]):
            pixel = np.int64(target[k] >> np.uint32(TEXEL_BITS))
            row, column = pixel // widths[camera], pixel % widths[camera]
            for tap in range(4):
                tile_row, tile_column = (row + tap // 2) // FRAME_TILE, (column + tap % 2) // FRAME_TILE
                tile = first_tile[camera] + tile_row * columns[camera] + tile_column
                if newest[tile] != number:
                    newest[tile] = number
                    if write:
                        block[position[tile]] = number
                    position[tile] += 1


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _mark(tiles: Any, block_start: Any, block: Any, touched: Any) -> None:
    for tile in tiles:
        for k in range(block_start[tile], block_start[tile + 1]):
            touched[block[k]] = True
