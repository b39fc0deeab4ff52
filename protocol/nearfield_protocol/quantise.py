"""Numbers in few bits: octahedral normals, shared-exponent RGB, unsigned 16 bit floats, positions in a box.

Pure array functions. Every decoder is exact in float32 (or says by how much not), so that decoding and encoding again gives the same
bits. Error bounds are derived in SPEC.md. Callers validate; here every input is finite and in range.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.layout import AREA_EXPONENT_BIAS, NORMAL_STEPS, POSITION_STEPS, RGB9E5_EXPONENT_BIAS

Floats = NDArray[np.floating[Any]]

MAX_RADIOMETRIC = 2.0**126
"""Largest magnitude of a radiant intensity or SH coefficient: rounding up cannot leave float32."""
MIN_SCALE_EXPONENT_RGB = -149 + RGB9E5_EXPONENT_BIAS + 9
"""The smallest step of the shared exponent is then 2^-149, the smallest float32."""
MIN_SCALE_EXPONENT_HALF = -149 + 24
MAX_SCALE_EXPONENT = 127
AREA_MAX = float((2**11 - 1) * 2.0 ** (63 - AREA_EXPONENT_BIAS - 10))
"""Largest area that a compact VAL can hold, m^2."""


def round_half_up(values: Floats) -> NDArray[np.float64]:
    """Round to the nearest integer, ties towards +infinity: the rule of JavaScript's Math.round, needed to agree with it."""
    values = np.asarray(values, np.float64)
    floor = np.floor(values)
    return np.asarray(floor + (values - floor >= 0.5))


def encode_normals(normals: Floats, generations: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Pack unit normals (n, 3) and generations (n,) into words (n,): octahedral map in 2 x 12 bit (Meyer et al. 2010).

    The angular error is at most sqrt(18) / 4094 rad = 0.0594 degrees; the six axes are exact.
    """
    n = np.asarray(normals, np.float64)
    n = n / np.abs(n).sum(axis=1, keepdims=True)
    x, y = n[:, 0], n[:, 1]
    lower = n[:, 2] < 0
    folded_x = (1 - np.abs(y)) * np.where(x < 0, -1.0, 1.0)
    folded_y = (1 - np.abs(x)) * np.where(y < 0, -1.0, 1.0)
    u = round_half_up(np.where(lower, folded_x, x) * NORMAL_STEPS).astype(np.int64)
    v = round_half_up(np.where(lower, folded_y, y) * NORMAL_STEPS).astype(np.int64)
    # Opposite points of the square's rim are the same direction: one of them is the canonical word.
    u, v = (
        np.where(np.abs(v) == NORMAL_STEPS, np.abs(u), u),
        np.where(np.abs(u) == NORMAL_STEPS, np.abs(v), v),
    )
    word = u + NORMAL_STEPS | v + NORMAL_STEPS << 12 | generations.astype(np.int64) << 24
    return np.asarray(word).astype(np.uint32)


def decode_normals(words: NDArray[np.uint32]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Undo `encode_normals`: unit normals (n, 3) and generations (n,). Coordinates must be at most 4094 (see `bad_normals`)."""
    w = words.astype(np.int64)
    x = ((w & 0xFFF) - NORMAL_STEPS) / NORMAL_STEPS
    y = ((w >> 12 & 0xFFF) - NORMAL_STEPS) / NORMAL_STEPS
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0)
    n = np.stack([x - np.where(x < 0, -fold, fold), y - np.where(y < 0, -fold, fold), z], axis=-1)
    n /= np.sqrt(n[:, 0] * n[:, 0] + n[:, 1] * n[:, 1] + n[:, 2] * n[:, 2])[:, None]
    return n.astype(np.float32), (w >> 24).astype(np.uint8)


def bad_normals(words: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Words whose octahedral coordinates are 4095, a value that no encoder writes."""
    return np.asarray(((words & 0xFFF) == 0xFFF) | ((words >> 12 & 0xFFF) == 0xFFF))


def _exponents_of_rounded(values: NDArray[np.float64], bits: int) -> NDArray[np.int64]:
    """Exponent e of each value > 0 such that value, rounded to `bits` significant bits, lies in [2^e, 2^(e + 1)).

    Zero gives the lowest exponent, -1100.
    """
    mantissa, exponent = np.frexp(values)
    carries = round_half_up(np.ldexp(mantissa, bits)) >= 2.0**bits
    return np.where(values > 0, exponent - 1 + carries, -1100).astype(np.int64)


def rgb9e5_scale_exponent(rgb: Floats) -> int:
    """Scale exponent that puts the largest of all channels at the top of the shared exponent's range. 0 if all are zero."""
    largest = float(np.max(rgb, initial=0.0))
    if largest == 0:
        return 0
    top = int(_exponents_of_rounded(np.array([largest]), 9)[0])
    return max(top - (31 - RGB9E5_EXPONENT_BIAS) + 1, MIN_SCALE_EXPONENT_RGB)


def encode_rgb9e5(rgb: Floats, scale_exponent: int = 0) -> NDArray[np.uint32]:
    """Pack RGB (..., 3), finite and >= 0, into RGB9_E5 words (...,): value = mantissa * 2^(exponent - 24 + scale_exponent).

    Values above 65408 * 2^scale_exponent saturate. The error of a channel is at most max(m / 511.5, 2^(scale_exponent - 25)) with m the
    largest channel of the same texel.
    """
    values = np.minimum(np.ldexp(np.asarray(rgb, np.float64), -scale_exponent), 65408.0)
    largest = values.max(axis=-1, initial=0.0)
    exponent = np.maximum(_exponents_of_rounded(largest, 9) + RGB9E5_EXPONENT_BIAS + 1, 0)
    mantissa = round_half_up(np.ldexp(values, (24 - exponent)[..., None])).astype(np.int64)
    return np.asarray(
        mantissa[..., 0] | mantissa[..., 1] << 9 | mantissa[..., 2] << 18 | exponent << 27
    ).astype(np.uint32)


def decode_rgb9e5(words: NDArray[np.uint32], scale_exponent: int = 0) -> NDArray[np.float32]:
    """Undo `encode_rgb9e5`, exactly: words (...,) to RGB (..., 3)."""
    w = words.astype(np.int64)
    mantissa = np.stack([w & 0x1FF, w >> 9 & 0x1FF, w >> 18 & 0x1FF], axis=-1)
    values = np.ldexp(mantissa.astype(np.float64), ((w >> 27) - 24 + scale_exponent)[..., None])
    return np.asarray(values, np.float32)


def encode_areas(areas: Floats) -> NDArray[np.uint16]:
    """Areas (n,), 0 <= area <= AREA_MAX, as unsigned floats of 6 + 10 bits; relative error <= 2^-11 from 2^-39 m^2 on."""
    values = np.asarray(areas, np.float64)
    exponent = np.maximum(_exponents_of_rounded(values, 11) + AREA_EXPONENT_BIAS, 1)
    mantissa = round_half_up(np.ldexp(values, AREA_EXPONENT_BIAS + 10 - exponent)).astype(np.int64)
    return np.asarray(np.minimum(mantissa + (exponent - 1 << 10), 0xFFFF)).astype(np.uint16)


def decode_areas(codes: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Undo `encode_areas`, exactly."""
    c = codes.astype(np.int64)
    exponent = np.maximum(c >> 10, 1)
    mantissa = c - (exponent - 1 << 10)
    return np.asarray(np.ldexp(mantissa.astype(np.float64), exponent - AREA_EXPONENT_BIAS - 10), np.float32)


def encode_positions(
    positions: Floats, bounds_min: NDArray[np.float32], bounds_size: NDArray[np.float32]
) -> NDArray[np.uint16]:
    """Positions (n, 3) inside the bounds (3,), (3,) as steps of size / 65535; error <= size / 131070 per axis."""
    steps = (np.asarray(positions, np.float64) - bounds_min.astype(np.float64)) / bounds_size.astype(
        np.float64
    )
    return np.clip(round_half_up(steps * POSITION_STEPS), 0, POSITION_STEPS).astype(np.uint16)


def decode_positions(
    steps: NDArray[np.uint16], bounds_min: NDArray[np.float32], bounds_size: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Undo `encode_positions`, up to the rounding of the position itself to float32."""
    fraction = steps.astype(np.float64) / POSITION_STEPS
    return (bounds_min.astype(np.float64) + fraction * bounds_size.astype(np.float64)).astype(np.float32)


def half_scale_exponent(values: Floats) -> int:
    """Scale exponent that puts the largest magnitude into [2^14, 2^15) of a half float. 0 if all are zero."""
    largest = float(np.max(np.abs(values), initial=0.0))
    if largest == 0:
        return 0
    return max(int(_exponents_of_rounded(np.array([largest]), 11)[0]) - 14, MIN_SCALE_EXPONENT_HALF)


def encode_halves(values: Floats, scale_exponent: int) -> NDArray[np.float16]:
    """Values divided by 2^scale_exponent as half floats (ties to even); relative error 2^-11, absolute at least 2^(scale_exponent - 25)."""
    return np.asarray(np.ldexp(np.asarray(values, np.float64), -scale_exponent), np.float16)


def decode_halves(halves: NDArray[np.float16], scale_exponent: int) -> NDArray[np.float32]:
    """Undo `encode_halves`, exactly."""
    return np.asarray(np.ldexp(halves.astype(np.float64), scale_exponent), np.float32)
