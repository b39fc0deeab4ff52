"""Where one surface ends and another begins in a camera picture, found along the edges of the mesh.

Testing pixel centres alone misses slivers: the pointed corner of a lamp seen at a grazing angle slips between the centres
and still fills a part of a pixel. Slivers are bounded by mesh edges, so the edges are followed with sub-pixel steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nearfield_calibration.fisheye import project
from nearfield_server.geometry.camera_view import RoomRays, pixel_surfaces
from nearfield_server.geometry.face_groups import welded_corners
from nearfield_server.records import CameraModel, RoomMesh

# Step along an edge, pixels.
_STEP = 0.4
# Sight lines are cast this far (pixels) to four sides of each step; the small one finds slivers, the large one steep borders.
_OFFSETS = (0.03, 0.25)
# An edge that passes right in front of a lens would need endless steps.
_MAX_STEPS = 20_000
# Pixels whose area, blurred by a tenth of a pixel, a border touches; and those one pixel farther (bilinear partners).
_TOUCH, _NEAR = 0.6, 1.1


class Borders(NamedTuple):
    """Pixels (H, W) bool that a visible border touches, and that it comes near to."""

    touched: NDArray[np.bool_]
    near: NDArray[np.bool_]


def boundary_edges(mesh: RoomMesh, groups: NDArray[np.int32]) -> NDArray[np.float64]:
    """(E, 2, 3) float64 end points of all edges that bound a surface or separate two.

    Args:
        mesh: room.
        groups: (F,) surface numbers of `face_groups`.
    """
    welded = welded_corners(mesh)
    ends = np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]])
    corners = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    ends = np.sort(ends, axis=1)
    key = ends[:, 0] * (int(welded.max()) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    group = np.tile(groups, 3)[order]
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(np.append(first, len(order)))
    mixed = np.minimum.reduceat(group, first) != np.maximum.reduceat(group, first)
    return np.asarray(mesh.positions[corners[order[first[mixed | (count == 1)]]]])


def find_borders(
    rays: RoomRays,
    edges: NDArray[np.float64],
    groups: NDArray[np.int32],
    normals: NDArray[np.float64],
    camera: CameraModel,
) -> Borders:
    """Mark the pixels of a camera picture that see a border between surfaces.

    Args:
        rays: of the room.
        edges: (E, 2, 3) from `boundary_edges`.
        groups: (F,) surface numbers.
        normals: (F, 3) geometric normals.
        camera: lens and pose.
    """
    lens = camera.intrinsics
    points = _edge_points(edges, camera.world_from_camera[:3, 3], max(lens.fx, lens.fy))
    pixels, valid = project(
        (points - camera.world_from_camera[:3, 3]) @ camera.world_from_camera[:3, :3], camera.intrinsics
    )
    pixels = pixels[valid]
    own = pixel_surfaces(rays, groups, normals, camera, pixels + _OFFSETS[0])
    is_border = np.zeros(len(pixels), dtype=np.bool_)
    for offset in _OFFSETS:
        for side in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            left = np.flatnonzero(~is_border)
            shifted = pixels[left] + offset * np.array(side)
            is_border[left] = pixel_surfaces(rays, groups, normals, camera, shifted) != own[left]
    border = pixels[is_border]
    return Borders(
        _mark(border, _TOUCH, (lens.height, lens.width)), _mark(border, _NEAR, (lens.height, lens.width))
    )


def _edge_points(
    edges: NDArray[np.float64], eye: NDArray[np.float64], pixels_per_radian: float
) -> NDArray[np.float64]:
    """(n, 3) points along all edges, closer together than a step as seen from the eye."""
    start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    squared = np.maximum((along * along).sum(axis=1), 1e-30)
    nearest = np.clip(((eye - start) * along).sum(axis=1) / squared, 0.0, 1.0)
    distance = np.linalg.norm(start + nearest[:, None] * along - eye, axis=1)
    steps = np.sqrt(squared) * pixels_per_radian / np.maximum(distance, 1e-6) / _STEP
    counts = np.clip(np.ceil(steps), 1, _MAX_STEPS).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(edges)), counts)
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    share = number / (counts[edge] - 1)
    return np.asarray(start[edge] + share[:, None] * along[edge])


def _mark(points: NDArray[np.float64], reach: float, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W) bool: pixels whose centre lies within `reach` of a point along both axes."""
    marked = np.zeros(shape, dtype=np.bool_)
    low = np.ceil(points - reach).astype(np.int64)
    for step_y in range(int(2 * reach) + 1):
        for step_x in range(int(2 * reach) + 1):
            column, row = low[:, 0] + step_x, low[:, 1] + step_y
            inside = (column <= points[:, 0] + reach) & (row <= points[:, 1] + reach)
            inside &= (column >= 0) & (row >= 0) & (column < shape[1]) & (row < shape[0])
            marked[row[inside], column[inside]] = True
    return marked
