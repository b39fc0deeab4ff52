"""Small pictures for people: linear radiance as 8-bit sRGB, brightness chosen from the picture, pixels that are no measurement marked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

GROUND = (19, 20, 22)
"""What lies outside the image circle: the ground of the pages, sRGB."""
BOUND_MARK = (255, 48, 48)
"""Pixels whose radiance is only a lower bound, sRGB."""
INVALID_MARK = (150, 80, 255)
"""Pixels inside the image circle without any value, sRGB."""
_KEY = 0.18
_JPEG_QUALITY = 85


@dataclass(frozen=True, slots=True, kw_only=True)
class ReducedPicture:
    """A picture averaged over blocks of its pixels.

    Attributes:
        radiance: (h, w, 3) float32, mean over the valid pixels of a block; 0 where there is none.
        valid: (h, w) float32, share of valid pixels.
        bound: (h, w) bool, a pixel of the block is only a lower bound.
        invalid: (h, w) bool, a pixel of the block is invalid although it lies inside the image circle.
    """

    radiance: NDArray[np.float32]
    valid: NDArray[np.float32]
    bound: NDArray[np.bool_]
    invalid: NDArray[np.bool_]


def preview_size(height: int, width: int, max_side: int) -> tuple[int, int]:
    """(height, width) with the longer side at most `max_side`, same shape; never larger than the picture."""
    scale = min(1.0, max_side / max(height, width))
    return max(1, round(height * scale)), max(1, round(width * scale))


def reduce_picture(
    pixels: NDArray[np.float16] | NDArray[np.float32], max_side: int, circle: NDArray[np.bool_] | None = None
) -> ReducedPicture:
    """Average a picture down. One marked pixel is enough to mark its block: a lamp of one pixel must not hide.

    Args:
        pixels: (H, W, 4) finite radiance >= 0; alpha 1 valid, between 0.5 and 1 a lower bound, else invalid.
        max_side: longer side of the result, pixels.
        circle: (H, W) bool, where the lens shows anything; None = everywhere.
    """
    height, width = preview_size(pixels.shape[0], pixels.shape[1], max_side)
    whole = pixels.astype(np.float32)
    alpha = whole[..., 3]
    is_valid = alpha > 0.5
    is_bound = is_valid & (alpha < 1.0)
    is_invalid = ~is_valid if circle is None else ~is_valid & circle
    whole *= is_valid[..., None]
    whole[..., 3] = is_valid
    small = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    valid = np.minimum(small[..., 3], 1.0)
    radiance = np.divide(
        small[..., :3],
        valid[..., None],
        out=np.zeros((height, width, 3), np.float32),
        where=valid[..., None] > 0,
    )
    return ReducedPicture(
        radiance=radiance,
        valid=valid,
        bound=_any(is_bound, height, width),
        invalid=_any(is_invalid, height, width),
    )


def _any(mask: NDArray[np.bool_], height: int, width: int) -> NDArray[np.bool_]:
    if not mask.any():
        return np.zeros((height, width), np.bool_)
    small = cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    found: NDArray[np.bool_] = small > 0
    return found


def middle_exposure(picture: ReducedPicture) -> float:
    """Factor that brings the geometric mean of the luminance to a middle grey (0.18); 1 for a black picture."""
    luminance = picture.radiance @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    lit = luminance[(picture.valid > 0.5) & (luminance > 0)]
    return float(_KEY / np.exp(np.log(lit.astype(np.float64)).mean())) if lit.size else 1.0


def srgb_codes(linear: NDArray[Any]) -> NDArray[np.uint8]:
    """Codes 0 to 255 in sRGB of linear values in [0, 1] (IEC 61966-2-1); values outside are clamped."""
    x = np.clip(np.asarray(linear, np.float32), 0.0, 1.0)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1 / 2.4) - 0.055)
    return np.rint(255.0 * encoded).astype(np.uint8)


def tone_map(radiance: NDArray[np.float32], exposure: float) -> NDArray[np.uint8]:
    """(h, w, 3) sRGB codes of `1 - exp(-exposure radiance)`: linear in the dark, and bright lamps keep their shape."""
    return srgb_codes(-np.expm1(-exposure * radiance))


def paint_preview(
    pixels: NDArray[np.float16] | NDArray[np.float32],
    *,
    max_side: int = 384,
    stops: float = 0.0,
    marks: bool = True,
    circle: NDArray[np.bool_] | None = None,
) -> NDArray[np.uint8]:
    """Paint a picture of radiance for people.

    Args:
        pixels: see `reduce_picture`.
        max_side: longer side of the result, pixels.
        stops: brighter (+) or darker (-) than chosen from the picture, powers of two.
        marks: paint lower bounds and invalid pixels in colours of their own.
        circle: see `reduce_picture`.

    Returns:
        (h, w, 3) uint8 sRGB, red first.
    """
    picture = reduce_picture(pixels, max_side, circle)
    return _compose(tone_map(picture.radiance, middle_exposure(picture) * 2.0**stops), picture, marks)


def as_exposed(signal: NDArray[np.float32], *, max_side: int, marks: bool = True) -> NDArray[np.uint8]:
    """Paint the signal of one exposure as it is: black at 0, white at 1, so that too long and too short can be seen.

    Args:
        signal: (H, W, 4) share of the signal range; alpha as in `reduce_picture`.
        max_side: longer side of the result, pixels.
        marks: paint saturated pixels.

    Returns:
        (h, w, 3) uint8 sRGB, red first.
    """
    picture = reduce_picture(signal, max_side)
    return _compose(srgb_codes(picture.radiance), picture, marks)


def _compose(shown: NDArray[np.uint8], picture: ReducedPicture, marks: bool) -> NDArray[np.uint8]:
    share = picture.valid[..., None]
    ground = np.array(GROUND, np.float32)
    painted: NDArray[np.uint8] = np.rint(shown * share + ground * (1.0 - share)).astype(np.uint8)
    if marks:
        painted[picture.invalid] = INVALID_MARK
        painted[picture.bound] = BOUND_MARK
    return painted


def encode_jpeg(picture: NDArray[np.uint8]) -> bytes:
    """JPEG file of an (h, w, 3) sRGB picture."""
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), options)
    return data.tobytes()
