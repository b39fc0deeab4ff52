"""Slow float64 oracle of ray casting: every ray against every triangle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nearfield_server.records import RoomMesh

_BATCH = 1 << 14


def first_face(
    mesh: RoomMesh, origins: NDArray[np.float64], directions: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Nearest triangle along each ray (Moeller and Trumbore 1997), both sides.

    Args:
        mesh: room.
        origins: (n, 3) metres.
        directions: (n, 3).

    Returns:
        Triangle (n,) int64 or -1, and distance (n,) in units of `directions` (infinity where nothing is hit).
    """
    corners = mesh.positions[mesh.faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    face = np.full(len(origins), -1, dtype=np.int64)
    distance = np.full(len(origins), np.inf)
    for start in range(0, len(origins), _BATCH):
        part = slice(start, start + _BATCH)
        ray, origin = directions[part, None], origins[part, None]
        crossed = np.cross(ray, second)
        determinant = (crossed * first).sum(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            offset = origin - corners[:, 0]
            u = (offset * crossed).sum(axis=-1) / determinant
            around = np.cross(offset, first)
            v = (ray * around).sum(axis=-1) / determinant
            t = (second * around).sum(axis=-1) / determinant
            hit = (np.abs(determinant) > 1e-15) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9)
        t = np.where(hit, t, np.inf)
        nearest = t.argmin(axis=1)
        distance[part] = t[np.arange(len(nearest)), nearest]
        face[part] = np.where(np.isfinite(distance[part]), nearest, -1)
    return face, distance
