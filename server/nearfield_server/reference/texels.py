"""Slow float64 oracle of the texel geometry: every triangle against every texel centre near it, no snapping."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nearfield_server.records import RoomMesh


class ReferenceTexels(NamedTuple):
    """Dense atlas in float64; rows of texels without triangle are zero.

    Attributes:
        face: (H, W) int64, triangle or -1.
        position: (H, W, 3) world, metres.
        normal: (H, W, 3) unit.
        jacobian: (H, W) m^2 of surface per texel (not normalised per triangle).
        edge_distance: (H, W) distance in texels of the centre to the nearest edge of its triangle, or of the nearest
            triangle edge for uncovered texels (infinity where none is near).
    """

    face: NDArray[np.int64]
    position: NDArray[np.float64]
    normal: NDArray[np.float64]
    jacobian: NDArray[np.float64]
    edge_distance: NDArray[np.float64]


def rasterise_texels(mesh: RoomMesh, height: int, width: int) -> ReferenceTexels:
    """Sample the atlas at texel centres; a centre exactly on an edge goes to the first triangle that holds it."""
    face = np.full((height, width), -1, dtype=np.int64)
    position, normal = np.zeros((height, width, 3)), np.zeros((height, width, 3))
    jacobian = np.zeros((height, width))
    edge_distance = np.full((height, width), np.inf)
    for number, corners in enumerate(mesh.faces):
        uv = mesh.uv[corners] * [width, height] - 0.5
        low = np.maximum(np.floor(uv.min(axis=0)).astype(int) - 1, 0)
        high = np.minimum(np.ceil(uv.max(axis=0)).astype(int) + 1, [width - 1, height - 1])
        columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        points = np.stack([columns, rows], axis=-1).astype(np.float64)
        first, second = uv[1] - uv[0], uv[2] - uv[0]
        doubled = first[0] * second[1] - first[1] * second[0]
        offset = points - uv[0]
        b = (offset[..., 0] * second[1] - offset[..., 1] * second[0]) / doubled
        c = (first[0] * offset[..., 1] - first[1] * offset[..., 0]) / doubled
        coordinates = np.stack([1 - b - c, b, c], axis=-1)
        lengths = np.linalg.norm(np.roll(uv, -2, axis=0) - np.roll(uv, -1, axis=0), axis=1)
        distance = (coordinates * abs(doubled) / lengths).min(axis=-1)
        window = (slice(low[1], high[1] + 1), slice(low[0], high[0] + 1))
        inside = (distance >= 0) & (face[window] < 0)
        edge_distance[window] = np.minimum(edge_distance[window], np.abs(distance))
        world = mesh.positions[corners]
        area = np.linalg.norm(np.cross(world[1] - world[0], world[2] - world[0])) / abs(doubled)
        shading = coordinates @ mesh.normals[corners]
        shading /= np.maximum(np.linalg.norm(shading, axis=-1, keepdims=True), 1e-12)
        face[window][inside] = number
        position[window][inside] = (coordinates @ world)[inside]
        normal[window][inside] = shading[inside]
        jacobian[window][inside] = area
    return ReferenceTexels(face, position, normal, jacobian, edge_distance)
