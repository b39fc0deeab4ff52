"""The door of the server: whatever a source delivers becomes a clean half-float picture, and what was wrong is counted.

One infinite pixel, let through, poisons thousands of texels (infinity times zero in a bilinear blend), one NaN everything after it.
On the way the picture is compared tile by tile with the one before: while a pixel is in a register the comparison is nearly free.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.capture.tile_tolerance import keep_tiles_within
from nearfield_server.errors import CaptureError
from nearfield_server.radiometry.half import HALF_MAX, float_to_half, half_to_float, pack_plain_rgb
from nearfield_server.records import FRAME_TILE, LOWER_BOUND_BITS, VALID_BITS

_HALF_MAX_BITS = 0x7BFF
INGEST_COUNTERS = ("nan", "infinite", "negative", "above_range", "lower_bound")
_NOTHING_BEFORE: Final = np.zeros((0, 0), np.uint64)


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _clean_pixel(source: NDArray[np.float32], row: int, column: int, counts: NDArray[np.uint64]) -> Any:
    """One pixel with anything in it as a word of four clean halves; no fastmath: it would remove the NaN test."""
    nan = infinite = negative = above = False
    word = np.uint64(0)
    for channel in range(3):
        value = source[row, column, channel]
        bits = np.uint64(0)
        if value >= np.float32(0.0) and value <= np.float32(HALF_MAX):
            bits = np.uint64(float_to_half(value + np.float32(0.0)))  # -0 becomes +0
        elif np.isnan(value):
            nan = True
        elif value < np.float32(0.0):
            infinite |= np.isinf(value)
            negative |= not np.isinf(value)
        else:
            infinite |= np.isinf(value)
            above |= not np.isinf(value)
            bits = np.uint64(_HALF_MAX_BITS)
        word |= bits << np.uint64(16 * channel)
    counts[0] += nan
    counts[1] += infinite
    counts[2] += negative
    counts[3] += above
    alpha = source[row, column, 3] if source.shape[2] == 4 else np.float32(1.0)
    # A pixel with one unknown channel is no measurement at all.
    if nan or not alpha > np.float32(0.5):
        return np.uint64(0)
    if alpha < np.float32(1.0):
        counts[4] += np.uint64(1)
        return word | np.uint64(LOWER_BOUND_BITS) << np.uint64(48)
    return word | np.uint64(VALID_BITS) << np.uint64(48)


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _clean_rows(
    source: NDArray[np.float32],
    circle: NDArray[np.bool_],
    use_circle: bool,
    target: NDArray[np.uint64],
    previous: NDArray[np.uint64],
    changed: NDArray[np.bool_],
    counts: NDArray[np.uint64],
) -> None:
    """Rows of float32 (H, W, C) to words (H, W) of four clean halves; tiles that differ from `previous` (if any) are marked."""
    height, width, num_channels = source.shape
    base, pixel_bytes = source.ctypes.data, np.int64(4 * num_channels)
    for row in range(height):
        for tile in range(changed.shape[1]):
            left, right = tile * FRAME_TILE, min((tile + 1) * FRAME_TILE, width)
            compare = previous.shape[0] != 0 and not changed[row // FRAME_TILE, tile]
            difference = np.uint64(0)
            for column in range(left, right):
                word, plain = pack_plain_rgb(base + np.int64(row * width + column) * pixel_bytes)
                if use_circle and not circle[row, column]:
                    word = np.uint64(0)
                elif num_channels == 4 or not plain:
                    word = _clean_pixel(source, row, column, counts)
                target[row, column] = word
                if compare:
                    difference |= word ^ previous[row, column]
            if difference != np.uint64(0):
                changed[row // FRAME_TILE, tile] = True


@njit(cache=True, nogil=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def _take_words(source: NDArray[np.uint64], inside: NDArray[np.bool_], out: NDArray[np.uint64]) -> Any:
    """Words (n,) inside the circle, 0 outside; returns what is odd about them (0 = all are clean), and the number of lower bounds.

    Clean is a word without signs, with a known alpha, and with exponents to which one can be added: neither infinity nor NaN.
    """
    oddities, bounds = np.uint64(0), np.uint64(0)
    least = np.uint64(LOWER_BOUND_BITS)
    for column in range(source.shape[0]):
        word = source[column]
        if not inside[column]:
            word = np.uint64(0)
        out[column] = word
        exponents = (word & np.uint64(0x7C007C007C00)) + np.uint64(0x040004000400)
        # The two known alphas follow each other; smaller ones wrap around.
        alpha = (word >> np.uint64(48)) - least
        bounds += np.uint64(alpha == np.uint64(0))
        is_known = alpha <= np.uint64(1) or word == np.uint64(0)
        oddities |= (exponents | word) & np.uint64(0x800080008000) if is_known else np.uint64(1)
    return oddities, bounds


@njit(cache=True, nogil=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def _differ(words: NDArray[np.uint64], others: NDArray[np.uint64]) -> bool:
    difference = np.uint64(0)
    for column in range(words.shape[0]):
        difference |= words[column] ^ others[column]
    return bool(difference)


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _clean_half_rows(
    source: NDArray[np.uint64],
    circle: NDArray[np.bool_],
    use_circle: bool,
    target: NDArray[np.uint64],
    previous: NDArray[np.uint64],
    changed: NDArray[np.bool_],
    counts: NDArray[np.uint64],
) -> None:
    """Like `_clean_rows`, from words (H, W) of four halves: most are clean already and pass as they are."""
    height, width = source.shape
    pixel = np.zeros((1, 1, 4), np.float32)
    everywhere = np.ones(FRAME_TILE, np.bool_)
    for row in range(height):
        for tile in range(changed.shape[1]):
            left, right = tile * FRAME_TILE, min((tile + 1) * FRAME_TILE, width)
            out = target[row, left:right]
            inside = circle[row, left:right] if use_circle else everywhere[: right - left]
            oddities, bounds = _take_words(source[row, left:right], inside, out)
            if oddities:
                for column in range(out.shape[0]):
                    word = out[column]
                    if word:
                        for channel in range(4):
                            bits = np.uint16(word >> np.uint64(16 * channel))
                            pixel[0, 0, channel] = half_to_float(bits)
                        out[column] = _clean_pixel(pixel, 0, 0, counts)
            else:
                counts[4] += bounds
            if previous.shape[0] != 0 and not changed[row // FRAME_TILE, tile]:
                changed[row // FRAME_TILE, tile] = _differ(out, previous[row, left:right])


def as_words(pixels: NDArray[np.float16]) -> NDArray[np.uint64]:
    """(H, W, 4) halves as (H, W) words of the same memory: equal words are equal pixels, bit for bit."""
    return pixels.view(np.uint64)[..., 0]


def ingest_frame(
    pixels: NDArray[np.float32] | NDArray[np.float16],
    target: NDArray[np.float16],
    image_circle: NDArray[np.bool_] | None = None,
    *,
    previous: NDArray[np.float16] | None = None,
    changed: NDArray[np.bool_] | None = None,
    tolerance: float = 0.0,
) -> dict[str, int]:
    """Turn a raw picture into a clean one, and find the tiles in which it differs from the one before.

    Per channel: NaN makes the whole pixel invalid; negative values become 0; values above the half range, infinity included, become 65504
    (the light is there, only its amount is a lower bound). Alpha is validity: inside the image circle with all channels known 1, or the
    largest half below 1 where the source says that the radiance is a lower bound; else 0.

    Args:
        pixels: (H, W, 3 or 4) float32 or float16 radiance; a fourth channel <= 0.5 (or NaN) marks a pixel as invalid, one between 0.5 and 1
            as a lower bound.
        target: (H, W, 4) float16, written completely (usually a slot of a frame ring).
        image_circle: (H, W) bool, where the lens shows anything; None = everywhere.
        previous: (H, W, 4) float16, the clean picture in use until now; None = there is none.
        changed: (ceil(H / FRAME_TILE), ceil(W / FRAME_TILE)) bool, written: False where `target` is `previous` bit for bit.
        tolerance: 0 = any different bit is a change; above, see `tile_tolerance.keep_tiles_within`.

    Returns:
        Number of pixels of each kind in `INGEST_COUNTERS`; pixels outside the image circle are not counted.

    Raises:
        CaptureError: wrong shape or dtype.
    """
    _check_input(pixels, target, image_circle)
    counts = np.zeros(len(INGEST_COUNTERS), np.uint64)
    circle = np.zeros((1, 1), np.bool_) if image_circle is None else image_circle
    if changed is None:
        changed = np.empty([-(-side // FRAME_TILE) for side in target.shape[:2]], np.bool_)
    changed[...] = previous is None
    words = as_words(target)
    before = _NOTHING_BEFORE if previous is None else as_words(previous)
    exact = before if tolerance == 0.0 else _NOTHING_BEFORE
    if pixels.dtype == np.float16 and pixels.shape[2] == 4:
        halves = as_words(np.ascontiguousarray(pixels, dtype=np.float16))
        _clean_half_rows(halves, circle, image_circle is not None, words, exact, changed, counts)
    else:
        raw = np.ascontiguousarray(pixels, dtype=np.float32)
        _clean_rows(raw, circle, image_circle is not None, words, exact, changed, counts)
    if previous is not None and tolerance > 0.0:
        keep_tiles_within(words, before, changed, tolerance)
    return dict(zip(INGEST_COUNTERS, counts.tolist(), strict=True))


def compile_kernels() -> None:
    """Compile the kernels, or load them from the cache, before the first picture comes."""
    words = np.zeros((1, 1, 4), np.float16)
    for pixels in (words, words.astype(np.float32)):
        ingest_frame(pixels, words.copy(), previous=words, tolerance=0.5)


def _check_input(
    pixels: NDArray[Any], target: NDArray[np.float16], image_circle: NDArray[np.bool_] | None
) -> None:
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or pixels.shape[:2] != target.shape[:2]:
        raise CaptureError(
            f"frame of shape {pixels.shape}, expected {(*target.shape[:2], 3)} or {(*target.shape[:2], 4)}"
        )
    if pixels.dtype not in (np.dtype(np.float32), np.dtype(np.float16)):
        raise CaptureError(f"frame of {pixels.dtype}, expected float32 or float16")
    if image_circle is not None and image_circle.shape != target.shape[:2]:
        raise CaptureError(f"image circle of shape {image_circle.shape}, expected {target.shape[:2]}")
