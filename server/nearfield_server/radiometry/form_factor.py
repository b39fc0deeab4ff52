"""Irradiance from area lights: the disc form that is sent to clients, and exact forms to judge it by."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def val_irradiance(
    points: NDArray[np.floating],
    normals: NDArray[np.floating],
    val_position: NDArray[np.floating],
    val_normal: NDArray[np.floating],
    radiant_intensity: NDArray[np.floating],
    area: float,
) -> NDArray[np.float64]:
    """Unoccluded irradiance from one virtual area light: `I max(0, n.w) max(0, n_val.-w) / (r^2 + A / pi)`.

    Differs from the paper: Rohmer et al. 2014, Eq. 6 divides by r^2 alone, which is singular at the light; the disc term
    is exact on the axis of a parallel disc (protocol/CONVENTIONS.md).

    Args:
        points: (..., 3) metres.
        normals: (..., 3) unit.
        val_position: (3,) metres.
        val_normal: (3,) unit.
        radiant_intensity: (C,) W/sr.
        area: m^2.

    Returns:
        (..., C) W/m^2, float64. A point at the light's own position receives 0.
    """
    offset = np.asarray(val_position, dtype=np.float64) - np.asarray(points, dtype=np.float64)
    distance_squared = np.einsum("...i,...i->...", offset, offset)
    inverse = np.where(
        distance_squared > 0.0, 1.0 / np.sqrt(np.where(distance_squared > 0.0, distance_squared, 1.0)), 0.0
    )
    cos_receiver = np.maximum(
        0.0, np.einsum("...i,...i->...", offset, np.asarray(normals, dtype=np.float64)) * inverse
    )
    cos_light = np.maximum(0.0, -(offset @ np.asarray(val_normal, dtype=np.float64)) * inverse)
    denominator = distance_squared + float(area) / np.pi
    geometry = np.where(
        denominator > 0.0, cos_receiver * cos_light / np.where(denominator > 0.0, denominator, 1.0), 0.0
    )
    return np.asarray(geometry[..., None] * np.asarray(radiant_intensity, dtype=np.float64))


def polygon_irradiance(
    points: NDArray[np.floating],
    normals: NDArray[np.floating],
    polygon: NDArray[np.floating],
    radiance: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Exact irradiance from a uniform Lambertian planar polygon wholly above the receiver's horizon (Lambert's formula).

    `E = L / 2 * sum over edges of (angle of the edge) (unit normal of the edge's cone . n)`.

    Args:
        points: (P, 3) metres.
        normals: (P, 3) unit.
        polygon: (V, 3) corners, counter-clockwise seen from the side that shines.
        radiance: (C,).

    Returns:
        (P, C) float64; 0 for receivers behind the polygon's plane.

    Raises:
        ValueError: part of the polygon lies below the horizon of a receiver in front of it (clip it first).
    """
    receivers = np.asarray(points, dtype=np.float64)
    receiver_normals = np.asarray(normals, dtype=np.float64)
    corners = np.asarray(polygon, dtype=np.float64)
    rays = corners[None] - receivers[:, None]
    facing = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    in_front = np.einsum("pi,i->p", receivers - corners[0], facing) > 0.0
    height = np.einsum("pvi,pi->pv", rays, receiver_normals)
    if np.any(height[in_front] < -1e-12):
        raise ValueError("polygon reaches below the horizon of a receiver; clip it before calling")
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    following = np.roll(rays, -1, axis=1)
    cone = np.cross(rays, following)
    sine = np.linalg.norm(cone, axis=-1)
    angle = np.arctan2(sine, np.einsum("pvi,pvi->pv", rays, following))
    weight = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 0.0)
    flux_vector = 0.5 * np.einsum("pv,pvi->pi", weight, cone)
    # Counter-clockwise from the shining side is clockwise from the receiver's side.
    projected = np.where(in_front, -np.einsum("pi,pi->p", flux_vector, receiver_normals), 0.0)
    return np.asarray(projected[:, None] * np.asarray(radiance, dtype=np.float64))


def disc_irradiance_on_axis(
    distance: NDArray[np.floating] | float, radius: float, radiance: float
) -> NDArray[np.float64]:
    """Exact irradiance of a receiver facing the centre of a parallel uniform disc: `pi L R^2 / (R^2 + d^2)`."""
    d = np.asarray(distance, dtype=np.float64)
    return np.asarray(np.pi * radiance * radius * radius / (radius * radius + d * d))
