"""Slow float64 oracle of ray casting: every ray against every triangle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nearfield_server.records import RoomMesh

_BATCH = 1 << 14


def first_face(
    mesh: RoomMesh, origins: NDArray[np.float64], directions: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Nearest triangle along each ray, both sides: plane first, then barycentric coordinates of the point.

    Args:
        mesh: room.
        origins: (n, 3) metres.
        directions: (n, 3).

    Returns:
        Triangle (n,) int64 or -1, and distance (n,) in units of `directions` (infinity where nothing is hit).
    """
    corners = mesh.positions[mesh.faces]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    # Rows: second and third barycentric coordinate and height above the triangle's plane, as functions of the position.
    local = np.linalg.inv(
        np.concatenate([edges, np.cross(edges[:, :, 0], edges[:, :, 1])[:, :, None]], axis=2)
    )
    at_corner = np.einsum("fkd,fd->kf", local, corners[:, 0])
    second, third, height = (np.ascontiguousarray(local[:, row].T) for row in range(3))
    face = np.full(len(origins), -1, dtype=np.int64)
    distance = np.full(len(origins), np.inf)
    for start in range(0, len(origins), _BATCH):
        part = slice(start, start + _BATCH)
        ray, origin = directions[part], origins[part]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (at_corner[2] - origin @ height) / (ray @ height)
            u = origin @ second - at_corner[0] + t * (ray @ second)
            v = origin @ third - at_corner[1] + t * (ray @ third)
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9)
        t = np.where(hit, t, np.inf)
        nearest = t.argmin(axis=1)
        distance[part] = t[np.arange(len(nearest)), nearest]
        face[part] = np.where(np.isfinite(distance[part]), nearest, -1)
    return face, distance
