"""Small changes of a picture that may be left out, and by how much they can be wrong.

The bound: after `keep_tiles_within`, every value in use differs from the measured one by at most `tolerance` times the value in use,
however long a tile has been kept, because each picture is compared with the values in use and not with the picture before. Light is
linear in the pixels and no weight is negative, so the same bound holds for every radiance and irradiance made of them:
|measured - used| <= tolerance * used.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.radiometry.half import half_to_float
from nearfield_server.records import FRAME_TILE


@njit(cache=True, nogil=True, inline="always")  # type: ignore[untyped-decorator]
def _is_within(word: int, used: int, tolerance: float) -> bool:
    """Whether three halves lie in the band around those in use, and validity is the same."""
    if word == used:
        return True
    if (word ^ used) >> np.uint64(48) != np.uint64(0):
        return False
    for channel in range(3):
        shift = np.uint64(16 * channel)
        new = np.float64(half_to_float(np.uint16((word >> shift) & np.uint64(0xFFFF))))
        old = np.float64(half_to_float(np.uint16((used >> shift) & np.uint64(0xFFFF))))
        if abs(new - old) > tolerance * old:
            return False
    return True


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def keep_tiles_within(
    target: NDArray[np.uint64], used: NDArray[np.uint64], changed: NDArray[np.bool_], tolerance: float
) -> None:
    """Put the pixels in use back into tiles that hardly changed, and mark the others.

    Args:
        target: (H, W) words of four halves, a clean picture; the tiles that are kept become those of `used`.
        used: (H, W) likewise, the picture in use until now.
        changed: (ceil(H / FRAME_TILE), ceil(W / FRAME_TILE)) bool, set where any value of a tile leaves its band or any pixel becomes
            valid or invalid.
        tolerance: half the width of the band relative to the value in use, > 0.
    """
    height, width = target.shape
    for tile_row in range(changed.shape[0]):
        top, bottom = tile_row * FRAME_TILE, min((tile_row + 1) * FRAME_TILE, height)
        for tile in range(changed.shape[1]):
            left, right = tile * FRAME_TILE, min((tile + 1) * FRAME_TILE, width)
            for row in range(top, bottom):
                for column in range(left, right):
                    if not _is_within(target[row, column], used[row, column], tolerance):
                        changed[tile_row, tile] = True
                        break
                if changed[tile_row, tile]:
                    break
            if not changed[tile_row, tile]:
                for row in range(top, bottom):
                    for column in range(left, right):
                        target[row, column] = used[row, column]
