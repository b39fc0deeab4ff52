"""Tiles of a picture as byte planes, and back: the form in which half floats compress best.

A pixel is a word of four halves. Plane b holds byte b of every word, tile after tile, row after row: exponents lie beside exponents,
and a plane of validity that is 1 everywhere costs nothing.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.errors import CaptureError
from nearfield_server.records import FRAME_TILE

WORD_BYTES = 8


def tile_grid(height: int, width: int) -> tuple[int, int]:
    """Rows and columns of tiles of a picture; those at the right and lower edge may be smaller."""
    return -(-height // FRAME_TILE), -(-width // FRAME_TILE)


def pixels_in_tiles(chosen: NDArray[np.bool_], height: int, width: int) -> int:
    """Pixels that the chosen tiles have together.

    Args:
        chosen: (rows, columns) of `tile_grid`.
        height: of the picture, pixels.
        width: of the picture, pixels.
    """
    rows, columns = chosen.shape
    heights = np.minimum(FRAME_TILE, height - FRAME_TILE * np.arange(rows))
    widths = np.minimum(FRAME_TILE, width - FRAME_TILE * np.arange(columns))
    return int(heights @ chosen @ widths)


def split_tiles(words: NDArray[np.uint64], chosen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Take tiles out of a picture.

    Args:
        words: (height, width), four halves each.
        chosen: (rows, columns) of `tile_grid`.

    Returns:
        (8, pixels in the chosen tiles): byte planes.
    """
    planes = np.empty((WORD_BYTES, pixels_in_tiles(chosen, *words.shape)), np.uint8)
    _split(words, chosen, planes)
    return planes


def join_tiles(planes: NDArray[np.uint8], chosen: NDArray[np.bool_], words: NDArray[np.uint64]) -> None:
    """Put tiles into a picture; the inverse of `split_tiles`.

    Args:
        planes: (8, pixels in the chosen tiles).
        chosen: (rows, columns) of `tile_grid`.
        words: (height, width), written where a tile is chosen.

    Raises:
        CaptureError: the shapes do not fit together.
    """
    expected = (WORD_BYTES, pixels_in_tiles(chosen, *words.shape))
    # The kernel does not look at bounds, and the planes come from another machine.
    if chosen.shape != tile_grid(*words.shape) or planes.shape != expected:
        raise CaptureError(
            f"byte planes of shape {planes.shape} for tiles {chosen.shape}, expected {expected} for {tile_grid(*words.shape)}"
        )
    _join(planes, chosen, words)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _split(words: NDArray[np.uint64], chosen: NDArray[np.bool_], planes: NDArray[np.uint8]) -> None:
    height, width = words.shape
    position = 0
    for tile_row in range(chosen.shape[0]):
        for tile_column in range(chosen.shape[1]):
            if not chosen[tile_row, tile_column]:
                continue
            left = tile_column * FRAME_TILE
            count = min(FRAME_TILE, width - left)
            for row in range(tile_row * FRAME_TILE, min((tile_row + 1) * FRAME_TILE, height)):
                for column in range(count):
                    word = words[row, left + column]
                    for byte in range(WORD_BYTES):
                        planes[byte, position + column] = np.uint8(word >> np.uint64(8 * byte))
                position += count


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _join(planes: NDArray[np.uint8], chosen: NDArray[np.bool_], words: NDArray[np.uint64]) -> None:
    height, width = words.shape
    position = 0
    for tile_row in range(chosen.shape[0]):
        for tile_column in range(chosen.shape[1]):
            if not chosen[tile_row, tile_column]:
                continue
            left = tile_column * FRAME_TILE
            count = min(FRAME_TILE, width - left)
            for row in range(tile_row * FRAME_TILE, min((tile_row + 1) * FRAME_TILE, height)):
                for column in range(count):
                    word = np.uint64(0)
                    for byte in range(WORD_BYTES):
                        word |= np.uint64(planes[byte, position + column]) << np.uint64(8 * byte)
                    words[row, left + column] = word
                position += count
