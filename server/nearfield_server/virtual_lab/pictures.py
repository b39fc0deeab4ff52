"""Writes radiance pictures as half-float OpenEXR and reports what the codec changed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
from numpy.typing import NDArray

# Previews are halved until they are at most this wide.
PREVIEW_WIDTH = 640


@dataclass(frozen=True, slots=True, kw_only=True)
class Codec:
    """How a picture is compressed.

    Attributes:
        dwaa_level: level of the lossy DWAA codec, or None for lossless PIZ.
        mantissa_bits: explicit mantissa bits of the half floats kept before compression (10 = all).
    """

    dwaa_level: float | None = None
    mantissa_bits: int = 10

    @property
    def label(self) -> str:
        """Name for scene.json."""
        return (
            f"PIZ, {self.mantissa_bits}-bit mantissa"
            if self.dwaa_level is None
            else f"DWAA{self.dwaa_level:g}"
        )


def round_mantissa(values: NDArray[Any], bits: int) -> NDArray[np.float16]:
    """Round to half floats with `bits` explicit mantissa bits (to nearest; relative error at most 2^-(bits + 1))."""
    half = np.asarray(values, dtype=np.float32).astype(np.float16)
    drop = 10 - bits
    if drop == 0:
        return half
    code = half.view(np.uint16).astype(np.uint32)
    kept = (code + np.uint32(1 << (drop - 1))) >> np.uint32(drop) << np.uint32(drop)
    return np.asarray(kept.astype(np.uint16).view(np.float16))


def write_exr(path: Path, radiance: NDArray[Any], codec: Codec) -> None:
    """Write an (H, W, 3) picture as half RGB."""
    header: dict[str, Any] = {"type": OpenEXR.scanlineimage}
    if codec.dwaa_level is None:
        header["compression"] = OpenEXR.PIZ_COMPRESSION
    else:
        header |= {"compression": OpenEXR.DWAA_COMPRESSION, "dwaCompressionLevel": float(codec.dwaa_level)}
    pixels = np.ascontiguousarray(round_mantissa(radiance, codec.mantissa_bits))
    with OpenEXR.File(header, {"RGB": pixels}) as file:
        file.write(str(path))


def read_exr(path: Path) -> NDArray[np.float32]:
    """Read the RGB channels, (H, W, 3) float32."""
    with OpenEXR.File(str(path)) as file:
        return np.asarray(file.channels()["RGB"].pixels, dtype=np.float32)


def codec_error(path: Path, radiance: NDArray[Any], emission: NDArray[np.float32]) -> dict[str, Any]:
    """What reading the file back differs by.

    Args:
        path: the written file.
        radiance: (H, W, 3) what was meant.
        emission: (H, W) share of each pixel that shows an emitter.

    Returns:
        `rms_rel`: RMS error over the mean, both over pixels that show no emitter. `p9995_rel`: 99.95th percentile of the error there over
        the same mean. `emitter_flux_rel`: relative error of the sum over pixels that show an emitter (0 if there are none).
    """
    error = read_exr(path).astype(np.float64) - radiance
    surface = emission == 0
    mean = max(float(radiance[surface].mean()), 1e-12)
    emitted = float(radiance[~surface].sum())
    return {
        "rms_rel": float(np.sqrt(np.mean(error[surface] ** 2))) / mean,
        "p9995_rel": float(np.percentile(np.abs(error[surface]), 99.95)) / mean,
        "emitter_flux_rel": abs(float(error[~surface].sum())) / emitted if emitted > 0 else 0.0,
    }


def write_preview(path: Path, radiance: NDArray[Any], exposure: float) -> None:
    """Write a JPEG for people, at most 640 pixels wide: exposure, clip, sRGB transfer function."""
    while radiance.shape[1] > PREVIEW_WIDTH:
        radiance = box_half(radiance)
    linear = np.clip(radiance * exposure, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)
    cv2.imwrite(str(path), np.round(encoded[..., ::-1] * 255).astype(np.uint8))


def write_mask(path: Path, coverage: NDArray[np.float32]) -> None:
    """Write the coverage of the virtual objects, 0 to 255."""
    cv2.imwrite(str(path), np.round(coverage * 255).astype(np.uint8))


def box_half(picture: NDArray[Any]) -> NDArray[Any]:
    """Exact 2x2 box average over the two axes before the last."""
    height, width = picture.shape[-3:-1]
    return np.asarray(
        picture.reshape(*picture.shape[:-3], height // 2, 2, width // 2, 2, 3).mean(axis=(-4, -2))
    )
