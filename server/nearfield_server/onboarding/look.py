"""What a camera sees right now, for the person who sets it up: a picture as exposed, its histogram, what is saturated, the image circle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nearfield_calibration.models import FisheyeIntrinsics
from nearfield_server.imaging.preview import as_exposed, encode_jpeg
from nearfield_server.onboarding.lens_guess import guess_lens

HISTOGRAM_BINS = 64
PICTURE_SIDE = 512
BRIGHT = 0.4
_LARGEST_STEP = 16.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """One look through a camera.

    Attributes:
        jpeg: picture of at most `PICTURE_SIDE` pixels a side, as bright as the exposure makes it.
        width, height: of the whole picture, pixels.
        pixel_format: that it was sent in.
        exposure_s: exposure time of this picture, seconds.
        exposure_range_s: shortest and longest that the camera can do; equal where it cannot be set.
        histogram: (HISTOGRAM_BINS,) share of the pixels by the strongest channel, from black to the full signal.
        bright: signal that nine of ten pixels stay below, share of the signal range.
        saturated_share: share of the pixels that the exposure was too long for.
        lens: guess from the image circle, for a field of view of 180 degrees.
        has_circle: the image circle was found; else the lens is only a default.
    """

    jpeg: bytes
    width: int
    height: int
    pixel_format: str
    exposure_s: float
    exposure_range_s: tuple[float, float]
    histogram: tuple[float, ...]
    bright: float
    saturated_share: float
    lens: FisheyeIntrinsics
    has_circle: bool


def take_look(
    signal: NDArray[np.float32],
    *,
    pixel_format: str,
    exposure_s: float,
    exposure_range_s: tuple[float, float],
    marks: bool = True,
) -> Look:
    """Look at one picture.

    Args:
        signal: (H, W, 4) float32, share of the signal range of the exposure; alpha as in frames: below 1 saturated, 0 invalid.
        pixel_format: for the result.
        exposure_s: for the result.
        exposure_range_s: for the result.
        marks: paint saturated pixels.
    """
    height, width = signal.shape[:2]
    strongest = signal[..., :3].max(axis=-1)
    counts, _ = np.histogram(np.clip(strongest, 0.0, 1.0), bins=HISTOGRAM_BINS, range=(0.0, 1.0))
    alpha = signal[..., 3]
    lens, has_circle = guess_lens(strongest)
    return Look(
        jpeg=encode_jpeg(as_exposed(signal, max_side=PICTURE_SIDE, marks=marks)),
        width=width,
        height=height,
        pixel_format=pixel_format,
        exposure_s=exposure_s,
        exposure_range_s=exposure_range_s,
        histogram=tuple((counts / counts.sum()).tolist()),
        bright=float(np.percentile(strongest, 90)),
        saturated_share=float(np.count_nonzero((alpha > 0.5) & (alpha < 1.0)) / alpha.size),
        lens=lens,
        has_circle=has_circle,
    )


def better_exposure(look: Look, longest_s: float) -> float:
    """Exposure time that brings the bright parts of the picture to `BRIGHT`: walls well above the noise, little saturated.

    Args:
        look: the picture until now.
        longest_s: seconds; longer ones slow the camera down.

    Returns:
        Seconds, within what the camera can do and at most a factor of 16 from the exposure until now.
    """
    shortest, longest = look.exposure_range_s
    factor = BRIGHT / look.bright if look.bright > 0 else _LARGEST_STEP
    # A saturated picture does not tell how much too bright it is.
    factor = 1 / _LARGEST_STEP if look.bright > 0.95 else min(factor, _LARGEST_STEP)
    return min(
        max(look.exposure_s * max(factor, 1 / _LARGEST_STEP), shortest), longest, max(longest_s, shortest)
    )
