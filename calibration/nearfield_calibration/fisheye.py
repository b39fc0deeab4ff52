"""Fish-eye projection and its inverse (Kannala-Brandt, atan2 form).

The lens formula is that of protocol/CONVENTIONS.md. Everything is float64: `atan2(hypot(x, y), z)` keeps full precision
near the axis and beyond 90 degrees, where `acos(z)` and division by z do not (OpenCV's own projection loses the sign of z).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nearfield_calibration.errors import CalibrationError
from nearfield_calibration.models import FisheyeIntrinsics

# Newton from a bracketed start converges quadratically; the bracket halves in the worst case, so 60 steps reach the last bit.
_MAX_ITERATIONS = 60
# Pixels computed by `project` may exceed the rim radius by rounding only.
_RIM_SLACK = 1e-12


def radius_of_angle(theta: ArrayLike, k: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """Normalised image radius r(theta) = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).

    Args:
        theta: (...) angles to the optical axis, radians.
        k: polynomial coefficients.

    Returns:
        (...) float64 radius in units of the focal length.
    """
    angle = np.asarray(theta, dtype=np.float64)
    square = angle * angle
    return np.asarray(angle * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3])))))


def radius_slope(theta: ArrayLike, k: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """Derivative dr/dtheta of `radius_of_angle`, (...) float64."""
    angle = np.asarray(theta, dtype=np.float64)
    square = angle * angle
    return np.asarray(1 + square * (3 * k[0] + square * (5 * k[1] + square * (7 * k[2] + square * 9 * k[3]))))


def check_intrinsics(intrinsics: FisheyeIntrinsics) -> None:
    """Refuse a lens that cannot be inverted inside its image circle.

    Raises:
        CalibrationError: a value is not finite or out of range, or r(theta) stops growing below `theta_max`
            (fitted polynomials of wide lenses often do; a smaller `theta_max` is the remedy).
    """
    numbers = (
        intrinsics.fx,
        intrinsics.fy,
        intrinsics.cx,
        intrinsics.cy,
        intrinsics.theta_max,
        *intrinsics.k,
    )
    if not all(math.isfinite(value) for value in numbers):
        raise CalibrationError(f"fish-eye intrinsics: expected finite numbers, found {numbers}.")
    if intrinsics.width < 1 or intrinsics.height < 1:
        raise CalibrationError(
            f"fish-eye size: expected at least 1 x 1, found {intrinsics.width} x {intrinsics.height}."
        )
    if intrinsics.fx <= 0 or intrinsics.fy <= 0:
        raise CalibrationError(f"fish-eye fx, fy: expected > 0, found {intrinsics.fx}, {intrinsics.fy}.")
    if not 0 < intrinsics.theta_max <= math.pi:
        raise CalibrationError(
            f"fish-eye theta_max: expected radians in (0, pi], found {intrinsics.theta_max}."
        )
    turning = first_turning_angle(intrinsics.k)
    if turning <= intrinsics.theta_max:
        raise CalibrationError(
            f"fish-eye k {intrinsics.k}: r(theta) stops growing at {turning:.6f} rad ({math.degrees(turning):.2f} deg), "
            f"below theta_max {intrinsics.theta_max:.6f} rad. Use a theta_max below it, or calibrate again."
        )


def first_turning_angle(k: tuple[float, float, float, float]) -> float:
    """Smallest angle > 0 in radians where dr/dtheta is 0, or infinity: the lens is one-to-one below it."""
    coefficients = [9 * k[3], 7 * k[2], 5 * k[1], 3 * k[0], 1.0]
    while coefficients and coefficients[0] == 0.0:
        coefficients.pop(0)
    if len(coefficients) < 2:
        return math.inf
    roots = np.roots(coefficients)
    # A double root touches zero without crossing; rounding turns it into a pair with tiny imaginary parts.
    real = roots.real[np.abs(roots.imag) <= 1e-7 * np.maximum(1.0, np.abs(roots))]
    positive = real[real > 0]
    return float(np.sqrt(positive.min())) if positive.size else math.inf


def project(
    points_camera: ArrayLike, intrinsics: FisheyeIntrinsics
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Project points to pixels.

    Args:
        points_camera: (..., 3) points or directions in the camera frame, any length > 0.
        intrinsics: lens; `check_intrinsics` holds.

    Returns:
        Pixels (..., 2) float64 as (x, y), NaN where invalid, and valid (...,) bool: the angle to the axis is at most
        `theta_max`. A valid pixel may lie outside the picture; `inside_picture` tells.

    Raises:
        CalibrationError: see `check_intrinsics`.
    """
    check_intrinsics(intrinsics)
    points = np.asarray(points_camera, dtype=np.float64)
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    rho = np.hypot(x, y)
    theta = np.arctan2(rho, z)
    valid = np.isfinite(points).all(axis=-1) & (theta <= intrinsics.theta_max) & ((rho > 0) | (z > 0))
    on_axis = rho == 0
    scale = np.where(on_axis, 0.0, radius_of_angle(np.where(valid, theta, 0.0), intrinsics.k))
    scale = np.divide(scale, rho, out=np.zeros_like(rho), where=valid & ~on_axis)
    pixels = np.stack(
        [intrinsics.cx + intrinsics.fx * scale * x, intrinsics.cy + intrinsics.fy * scale * y], axis=-1
    )
    return np.where(valid[..., None], pixels, np.nan), valid


def unproject(
    pixels: ArrayLike, intrinsics: FisheyeIntrinsics
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Viewing directions of pixels: the exact inverse of `project` by Newton's method on r(theta).

    Args:
        pixels: (..., 2) as (x, y).
        intrinsics: lens; `check_intrinsics` holds.

    Returns:
        Unit directions (..., 3) float64 in the camera frame, NaN where invalid, and valid (...,) bool: the pixel lies inside
        the image circle r <= r(theta_max).

    Raises:
        CalibrationError: see `check_intrinsics`.
    """
    check_intrinsics(intrinsics)
    points = np.asarray(pixels, dtype=np.float64)
    x = (points[..., 0] - intrinsics.cx) / intrinsics.fx
    y = (points[..., 1] - intrinsics.cy) / intrinsics.fy
    radius = np.hypot(x, y)
    rim = float(radius_of_angle(intrinsics.theta_max, intrinsics.k))
    valid = np.isfinite(radius) & (radius <= rim * (1 + _RIM_SLACK))
    theta = angle_of_radius(np.where(valid, np.minimum(radius, rim), 0.0), intrinsics)
    sine_over_radius = np.divide(np.sin(theta), radius, out=np.ones_like(radius), where=valid & (radius > 0))
    safe_x, safe_y = np.where(valid, x, 0.0), np.where(valid, y, 0.0)
    directions = np.stack([sine_over_radius * safe_x, sine_over_radius * safe_y, np.cos(theta)], axis=-1)
    return np.where(valid[..., None], directions, np.nan), valid


def angle_of_radius(radius: ArrayLike, intrinsics: FisheyeIntrinsics) -> NDArray[np.float64]:
    """Angle theta with r(theta) = radius, for 0 <= radius <= r(theta_max): Newton, kept inside a shrinking bracket.

    Args:
        radius: (...) normalised radii.
        intrinsics: lens with r growing up to `theta_max`.

    Returns:
        (...) float64 radians in [0, theta_max].
    """
    target = np.asarray(radius, dtype=np.float64)
    low, high = np.zeros_like(target), np.full_like(target, intrinsics.theta_max)
    theta = np.clip(target, 0.0, intrinsics.theta_max)
    for _ in range(_MAX_ITERATIONS):
        error = radius_of_angle(theta, intrinsics.k) - target
        low, high = np.where(error < 0, theta, low), np.where(error > 0, theta, high)
        step = theta - error / np.maximum(radius_slope(theta, intrinsics.k), 1e-12)
        following = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        following = np.where(error == 0, theta, following)
        converged = np.abs(following - theta) <= 4e-16 * np.maximum(following, 1e-3)
        theta = following
        if bool(np.all(converged)):
            break
    return theta


def inside_picture(pixels: ArrayLike, intrinsics: FisheyeIntrinsics) -> NDArray[np.bool_]:
    """Whether (..., 2) pixels lie on the picture [-0.5, width - 0.5] x [-0.5, height - 0.5]; NaN is outside."""
    points = np.asarray(pixels, dtype=np.float64)
    x, y = points[..., 0], points[..., 1]
    return np.asarray(
        (x >= -0.5) & (x <= intrinsics.width - 0.5) & (y >= -0.5) & (y <= intrinsics.height - 0.5),
        dtype=np.bool_,
    )


def pixels_per_steradian(theta: ArrayLike, intrinsics: FisheyeIntrinsics) -> NDArray[np.float64]:
    """Local resolution fx fy r(theta) r'(theta) / sin(theta), (...) float64; its limit on the axis is fx fy.

    Args:
        theta: (...) angles to the optical axis in [0, theta_max], below pi.
        intrinsics: lens.
    """
    angle = np.asarray(theta, dtype=np.float64)
    sine = np.sin(angle)
    stretch = np.divide(radius_of_angle(angle, intrinsics.k), sine, out=np.ones_like(angle), where=sine > 0)
    return np.asarray(intrinsics.fx * intrinsics.fy * stretch * radius_slope(angle, intrinsics.k))
