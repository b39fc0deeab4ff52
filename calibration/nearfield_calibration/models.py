"""Frozen camera models. Conventions: protocol/CONVENTIONS.md (OpenCV camera frame, integer pixel centres)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class FisheyeIntrinsics:
    """Kannala-Brandt lens; `k = (0, 0, 0, 0)` is the equidistant lens.

    Attributes:
        width: pixels. height: pixels.
        fx: pixels per radian at the centre. fy: the same along y.
        cx: x of the principal point, pixels. cy: y of it.
        k: odd polynomial coefficients (k1, k2, k3, k4) of r(theta).
        theta_max: largest valid angle to +z, radians; beyond it the picture holds nothing.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k: tuple[float, float, float, float]
    theta_max: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PinholeIntrinsics:
    """Ideal pinhole lens: `u = cx + fx x / z`, `v = cy + fy y / z`, all in pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
