"""Errors of a composite picture against path-traced truth, and the one display transform they are shown with.

Pictures are (H, W, 3) linear radiance, row 0 on top. Definitions are those of the evaluation bundles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FLIP_PIXELS_PER_DEGREE = 67.0
OBJECT_COVERAGE = 0.999
SCENE_COVERAGE = 0.001
_EXPOSED_PERCENTILE, _EXPOSED_VALUE = 98.0, 0.9
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def average_2x2(picture: NDArray[np.floating]) -> NDArray[np.float64]:
    """Mean of each 2x2 block: (2 H, 2 W, ...) -> (H, W, ...).

    Raises:
        ValueError: odd height or width.
    """
    height, width = picture.shape[:2]
    if height % 2 or width % 2:
        raise ValueError(f"expected an even height and width, found {height} x {width}")
    blocks = np.asarray(picture, np.float64).reshape(height // 2, 2, width // 2, 2, *picture.shape[2:])
    return np.asarray(blocks.mean(axis=(1, 3)))


def object_rel_rmse(
    composite: NDArray[np.floating], truth: NDArray[np.floating], coverage: NDArray[np.floating]
) -> float | None:
    """RMSE over the pixels wholly covered by virtual objects, over the mean truth there; None where there are no such pixels.

    Args:
        composite: (H, W, 3).
        truth: (H, W, 3).
        coverage: (H, W) in [0, 1].
    """
    inside = coverage > OBJECT_COVERAGE
    mean = float(truth[inside].mean()) if inside.any() else 0.0
    if mean <= 0.0:
        return None
    return float(np.sqrt(np.mean((composite[inside] - truth[inside]) ** 2))) / mean


def shadow_rel_rmse(
    composite_change: NDArray[np.floating],
    truth_change: NDArray[np.floating],
    coverage: NDArray[np.floating],
    sees_emitter: NDArray[np.bool_],
) -> float | None:
    """Norm of the error of the change that virtual objects make to real surfaces, over the norm of the true change; 1 = no shadow drawn.

    Args:
        composite_change: (H, W, 3) composite less the background that it was drawn on.
        truth_change: (H, W, 3) truth less the true background.
        coverage: (H, W) of the virtual objects.
        sees_emitter: (H, W), pixels that show a light source; they are left out.

    Returns:
        The ratio, or None where the objects change nothing.
    """
    real = (coverage < SCENE_COVERAGE) & ~sees_emitter
    norm = float(np.linalg.norm(truth_change[real]))
    return float(np.linalg.norm(composite_change[real] - truth_change[real])) / norm if norm > 0.0 else None


def luminance(picture: NDArray[np.floating]) -> NDArray[np.float64]:
    """Relative luminance of linear Rec. 709: (..., 3) -> (...)."""
    return np.asarray(np.asarray(picture, np.float64) @ _LUMINANCE)


def common_exposure(backgrounds: Sequence[NDArray[np.floating]]) -> float:
    """Factor that brings the 98th percentile of the luminance over all pictures together to 0.9; 1 for black pictures."""
    if not backgrounds:
        return 1.0
    bright = float(
        np.percentile(np.concatenate([luminance(p).ravel() for p in backgrounds]), _EXPOSED_PERCENTILE)
    )
    return _EXPOSED_VALUE / bright if bright > 0.0 else 1.0


def display(picture: NDArray[np.floating], exposure: float) -> NDArray[np.float32]:
    """Exposure, clipping to [0, 1], sRGB transfer function (IEC 61966-2-1)."""
    linear = np.clip(np.asarray(picture, np.float64) * exposure, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1.0 / 2.4) - 0.055)
    return encoded.astype(np.float32)


def flip_mean(reference: NDArray[np.float32], test: NDArray[np.float32]) -> float:
    """Mean FLIP error (Andersson et al. 2020) of two displayed sRGB pictures, 67 pixels per degree."""
    import flip_evaluator

    _, mean, _ = flip_evaluator.evaluate(
        np.ascontiguousarray(reference, np.float32),
        np.ascontiguousarray(test, np.float32),
        "LDR",
        inputsRGB=True,
        applyMagma=False,
        computeMeanError=True,
        parameters={"ppd": FLIP_PIXELS_PER_DEGREE},
    )
    return float(mean)


def ssim(reference: NDArray[np.float32], test: NDArray[np.float32]) -> float:
    """Structural similarity (Wang et al. 2004, Gaussian window of 1.5 pixels) of two displayed sRGB pictures, mean over channels."""
    from skimage.metrics import structural_similarity

    return float(
        structural_similarity(
            reference,
            test,
            data_range=1.0,
            channel_axis=2,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
        )
    )
