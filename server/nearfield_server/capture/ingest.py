"""The door of the server: whatever a source delivers becomes a clean half-float picture, and what was wrong is counted.

One infinite pixel, let through, poisons thousands of texels (infinity times zero in a bilinear blend), one NaN everything after it.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.errors import CaptureError
from nearfield_server.radiometry.half import as_uint16, float_to_half

HALF_MAX = 65504.0
_HALF_MAX_BITS = 0x7BFF
_HALF_ONE_BITS = 0x3C00
INGEST_COUNTERS = ("nan", "infinite", "negative", "above_range")


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _clean_rows(
    source: NDArray[np.float32],
    circle: NDArray[np.bool_],
    use_circle: bool,
    target: NDArray[np.uint16],
    counts: NDArray[np.uint64],
) -> None:
    """Rows of float32 (H, W, C) to the bits of clean halves (H, W, 4); no fastmath: it would remove the NaN test."""
    num_channels = source.shape[2]
    for row in range(source.shape[0]):
        for column in range(source.shape[1]):
            nan = infinite = negative = above = False
            known = not use_circle or circle[row, column]
            if known:
                for channel in range(3):
                    value = source[row, column, channel]
                    if value >= np.float32(0.0) and value <= np.float32(HALF_MAX):
                        target[row, column, channel] = float_to_half(value)
                    elif np.isnan(value):
                        nan = True
                    elif value < np.float32(0.0):
                        infinite |= np.isinf(value)
                        negative |= not np.isinf(value)
                        target[row, column, channel] = np.uint16(0)
                    else:
                        infinite |= np.isinf(value)
                        above |= not np.isinf(value)
                        target[row, column, channel] = np.uint16(_HALF_MAX_BITS)
                # A pixel with one unknown channel is no measurement at all.
                known = not nan and (num_channels == 3 or source[row, column, 3] > np.float32(0.5))
            if known:
                target[row, column, 3] = np.uint16(_HALF_ONE_BITS)
            else:
                for channel in range(4):
                    target[row, column, channel] = np.uint16(0)
            counts[0] += nan
            counts[1] += infinite
            counts[2] += negative
            counts[3] += above


def ingest_frame(
    pixels: NDArray[np.float32] | NDArray[np.float16],
    target: NDArray[np.float16],
    image_circle: NDArray[np.bool_] | None = None,
) -> dict[str, int]:
    """Turn a raw picture into a clean one.

    Per channel: NaN makes the whole pixel invalid; negative values become 0; values above the half range, infinity included, become 65504
    (the light is there, only its amount is a lower bound). Alpha is validity: 1 inside the image circle with all channels known, else 0.

    Args:
        pixels: (H, W, 3 or 4) float32 or float16 radiance; a fourth channel <= 0.5 (or NaN) marks a pixel as invalid.
        target: (H, W, 4) float16, written completely (usually a slot of a frame ring).
        image_circle: (H, W) bool, where the lens shows anything; None = everywhere.

    Returns:
        Number of pixels of each kind in `INGEST_COUNTERS`; pixels outside the image circle are not counted.

    Raises:
        CaptureError: wrong shape or dtype.
    """
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or pixels.shape[:2] != target.shape[:2]:
        raise CaptureError(
            f"frame of shape {pixels.shape}, expected {(*target.shape[:2], 3)} or {(*target.shape[:2], 4)}"
        )
    if pixels.dtype not in (np.dtype(np.float32), np.dtype(np.float16)):
        raise CaptureError(f"frame of {pixels.dtype}, expected float32 or float16")
    if image_circle is not None and image_circle.shape != target.shape[:2]:
        raise CaptureError(f"image circle of shape {image_circle.shape}, expected {target.shape[:2]}")
    raw = np.ascontiguousarray(pixels, dtype=np.float32)
    counts = np.zeros(len(INGEST_COUNTERS), np.uint64)
    circle = np.zeros((1, 1), np.bool_) if image_circle is None else image_circle
    _clean_rows(raw, circle, image_circle is not None, as_uint16(target), counts)
    return dict(zip(INGEST_COUNTERS, counts.tolist(), strict=True))
