"""Smaller pictures for narrow links: means of linear radiance over blocks of pixels, knowing which pixels are measurements."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_LOWER_BOUND = 0.75


def reduce_picture(
    pixels: NDArray[np.float32] | NDArray[np.float16], factor: int, out: NDArray[np.float32]
) -> None:
    """Mean over blocks of `factor` x `factor` pixels.

    Only valid pixels without NaN count. A block is valid if at least half of its pixels are, and a lower bound if one of them is.

    Args:
        pixels: (H, W, 3 or 4), see `RawFrame`; H and W are multiples of the factor.
        factor: 1 or more.
        out: (H / factor, W / factor, 4) float32, written: means and alpha 1, 0.75 (lower bound) or 0.
    """
    raw = np.ascontiguousarray(pixels, dtype=np.float32)
    height, width = raw.shape[:2]
    if out.shape != (height // factor, width // factor, 4) or height % factor or width % factor:
        raise ValueError(f"pictures of {raw.shape} do not give {out.shape} by blocks of {factor} x {factor}")
    _reduce(raw, factor, out)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _reduce(raw: NDArray[np.float32], factor: int, out: NDArray[np.float32]) -> None:
    with_alpha = raw.shape[2] == 4
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            red = green = blue = 0.0
            count, bounds = 0, 0
            for y in range(row * factor, (row + 1) * factor):
                for x in range(column * factor, (column + 1) * factor):
                    alpha = raw[y, x, 3] if with_alpha else np.float32(1.0)
                    r, g, b = raw[y, x, 0], raw[y, x, 1], raw[y, x, 2]
                    if not alpha > 0.5 or np.isnan(r) or np.isnan(g) or np.isnan(b):
                        continue
                    red += r
                    green += g
                    blue += b
                    count += 1
                    if alpha < 1.0:
                        bounds += 1
            if 2 * count >= factor * factor:
                out[row, column, 0] = red / count
                out[row, column, 1] = green / count
                out[row, column, 2] = blue / count
                out[row, column, 3] = _LOWER_BOUND if bounds else 1.0
            else:
                out[row, column, :] = 0.0
