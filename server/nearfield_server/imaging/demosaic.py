"""Colours between the samples of a Bayer mosaic, in linear light, row by row.

Linear filters ring: next to a lamp of a thousand times the room's radiance a filter with negative weights leaves black and coloured
pixels, and cutting those off adds light that is not there. Filters without negative weights (bilinear) blur lamps into the room. Here
colours are carried over as *ratios*, which cannot become negative, along the direction in which the mosaic changes least:

- green at a red or blue sample c: along each axis the mean of the two green neighbours times c over the mean of c and its neighbours of
  the same colour; the axes are blended by inverse squares of their gradients.
- red and blue: green times the ratio of the sums of that colour and of green over the two or four nearest samples of that colour.

All ratios are of values plus an `offset` of some standard deviations of the dark noise: far above it these are ratios, far below plain
differences, so that noise is not divided by noise. Samples themselves are kept as they are (down to -3/4 of the offset), and no colour
becomes more than twice the largest value that it was made of: beside a lamp of one colour the ratio of another one may be anything.

A row of the mosaic is stored as two half rows: its colour samples and its green samples, so that all neighbours lie at unit stride. With
`parity` the column parity of the colour samples of the row, colour sample j lies between green samples j - 1 + parity and j + parity, and
above and below it are green samples j of the other rows. All half rows hold positive values, offset included; each has `PAD` mirrored
samples at both ends.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

PAD: Final = 1
_JIT = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "nnan", "nsz"}}


@njit(**_JIT)  # type: ignore[untyped-decorator]
def mirror_ends(half_row: NDArray[np.float32], parity: int) -> None:
    """Fill the padding of a half row of the columns of a parity, as if the picture were mirrored about its outermost columns."""
    last = half_row.shape[0] - 1
    half_row[0] = half_row[1] if parity else half_row[2]
    half_row[last] = half_row[last - 2] if parity else half_row[last - 1]


@njit(**_JIT)  # type: ignore[untyped-decorator]
def split_row(
    row: NDArray[np.float32],
    parity: int,
    offset: np.float32,
    colour: NDArray[np.float32],
    green: NDArray[np.float32],
) -> None:
    """(W,) samples to the half rows (W / 2 + 2 PAD) of its colour and green ones; `parity` is the column of the first colour sample."""
    least = np.float32(0.25) * offset
    # Strides that the compiler knows: six times faster than an index with the parity in it.
    even, odd = (green, colour) if parity else (colour, green)
    for index in range(row.shape[0] // 2):
        even[index + 1] = max(row[2 * index] + offset, least)
        odd[index + 1] = max(row[2 * index + 1] + offset, least)
    mirror_ends(colour, parity)
    mirror_ends(green, 1 - parity)


@njit(**_JIT)  # type: ignore[untyped-decorator]
def interpolate_green(
    colour: NDArray[np.float32],
    green: NDArray[np.float32],
    colour_above: NDArray[np.float32],
    colour_below: NDArray[np.float32],
    green_above: NDArray[np.float32],
    green_below: NDArray[np.float32],
    parity: int,
    offset: np.float32,
    out: NDArray[np.float32],
) -> None:
    """Green at the colour samples of a row; all half rows.

    Args:
        colour: samples of the row.
        green: likewise.
        colour_above: of the same colour, two rows above.
        colour_below: two rows below.
        green_above: one row above.
        green_below: one row below.
        parity: of the row.
        offset: see the module, > 0.
        out: green at `colour`, padding included.
    """
    half, two = np.float32(0.5), np.float32(2.0)
    left, right = green[parity:], green[parity + 1 :]
    for index in range(1, out.shape[0] - 1):
        c = colour[index]
        west, east = left[index - 1], right[index - 1]
        north, south = green_above[index], green_below[index]
        same_x = half * (colour[index - 1] + colour[index + 1])
        same_y = half * (colour_above[index] + colour_below[index])
        change_x = abs(west - east) + two * abs(c - same_x) + offset
        change_y = abs(north - south) + two * abs(c - same_y) + offset
        under_x, under_y = c + same_x, c + same_y
        # Weights: an axis counts as much as the other one changes, squared. One division for both ratios and the blend.
        weight_x, weight_y = change_y * change_y, change_x * change_x
        over = weight_x * (west + east) * under_y + weight_y * (north + south) * under_x
        out[index] = c * over / ((weight_x + weight_y) * under_x * under_y)
    mirror_ends(out, parity)


@njit(**_JIT)  # type: ignore[untyped-decorator]
def interpolate_colours(
    colour: NDArray[np.float32],
    green: NDArray[np.float32],
    green_at_colour: NDArray[np.float32],
    other_above: NDArray[np.float32],
    other_below: NDArray[np.float32],
    green_above: NDArray[np.float32],
    green_below: NDArray[np.float32],
    parity: int,
    out_at_colour: NDArray[np.float32],
    out_at_green: NDArray[np.float32],
) -> None:
    """The other colours of a row; half rows with padding in, (W / 2,) values without padding out.

    Args:
        colour: samples of the row.
        green: likewise.
        green_at_colour: see `interpolate_green`.
        other_above: samples of the other colour, one row above.
        other_below: one row below.
        green_above: green at `other_above`.
        green_below: green at `other_below`.
        parity: of the row.
        out_at_colour: (W / 2,) the other colour at the colour samples.
        out_at_green: (2, W / 2) the row's colour, and the other colour, at the green samples.
    """
    half, two = np.float32(0.5), np.float32(2.0)
    upper, lower = other_above[parity:], other_below[parity:]
    upper_green, lower_green = green_above[parity:], green_below[parity:]
    for index in range(out_at_colour.shape[0]):
        here = green_at_colour[index + 1]
        over = upper[index] + upper[index + 1] + lower[index] + lower[index + 1]
        under = upper_green[index] + upper_green[index + 1] + lower_green[index] + lower_green[index + 1]
        out_at_colour[index] = min(here * over / under, max(two * here, half * over))
    beside, beside_green = colour[1 - parity :], green_at_colour[1 - parity :]
    for index in range(out_at_colour.shape[0]):
        here = green[index + 1]
        over_x, under_x = beside[index] + beside[index + 1], beside_green[index] + beside_green[index + 1]
        out_at_green[0, index] = min(here * over_x / under_x, max(two * here, over_x))
        over_y = other_above[index + 1] + other_below[index + 1]
        under_y = green_above[index + 1] + green_below[index + 1]
        out_at_green[1, index] = min(here * over_y / under_y, max(two * here, over_y))
