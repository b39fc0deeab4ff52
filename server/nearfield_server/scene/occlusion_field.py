"""Occlusion field of a virtual object: how much of the surrounding sphere it blocks, seen from points around it.

A coarse lattice around the object holds the SH coefficients of O(w) = 1 where a ray in direction w hits the object. The client
takes from it the
indirect light that the object keeps from real surfaces, and the light that it bounces onto them. Close to the object the field
is bounded by the cell size;
the lattice is laid so that one layer of cell centres lies just under the object, where the surface that it stands on is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nearfield_server.radiometry.sh import sh_basis
from nearfield_server.scene.ray_caster import RayCaster
from nearfield_server.scene.transfer import Progress

MAX_RESOLUTION = 20
NUM_CHANNELS = 12
# A cell centre inside the object sees back faces in (nearly) every direction that hits; outside, front faces come first.
_INSIDE_SHARE = 0.5
# Height of the object's lowest point above the nearest layer of cell centres, relative to the cell.
_GROUND_GAP = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class OcclusionField:
    """Occlusion on a lattice of cells in object axes.

    Attributes:
        coeffs: (nz, ny, nx, 12) float16; nine SH coefficients of O(w), then three zeros. Cell (i, j, k) has its centre at
            `box_min + box_size * ((k + 0.5) / nx, (j + 0.5) / ny, (i + 0.5) / nz)`.
        box_min: (3,) float64, metres. box_size: (3,) float64, metres.
    """

    coeffs: NDArray[np.float16]
    box_min: NDArray[np.float64]
    box_size: NDArray[np.float64]

    @property
    def resolution(self) -> tuple[int, int, int]:
        """Number of cells (nx, ny, nz)."""
        nz, ny, nx, _ = self.coeffs.shape
        return nx, ny, nz

    def sample(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Trilinear value at points in object axes, as a clamped 3-D texture gives it; zero outside the box: (n, 3) -> (n, 9)."""
        where = (np.asarray(points, np.float64) - self.box_min) / self.box_size
        inside = np.all((where >= 0.0) & (where <= 1.0), axis=1)
        lattice = (where * np.array(self.resolution) - 0.5)[:, ::-1].T
        values = self.coeffs.astype(np.float64)
        result = np.stack(
            [ndimage.map_coordinates(values[..., k], lattice, order=1, mode="nearest") for k in range(9)],
            axis=1,
        )
        result[~inside] = 0.0
        return result


def compute_occlusion_field(
    positions: NDArray[np.floating],
    faces: NDArray[np.integer],
    *,
    max_resolution: int = MAX_RESOLUTION,
    num_rays: int = 512,
    progress: Progress | None = None,
) -> OcclusionField:
    """Trace the occlusion field of a mesh.

    The box reaches one bounding radius beyond the object on every side; farther out it fills less than a fifteenth of the
    sphere. Cells whose centre is
    inside the object repeat the nearest cell outside, so that filtering does not carry the total occlusion of the inside
    through the surface.

    Args:
        positions: (V, 3) object frame, metres.
        faces: (F, 3).
        max_resolution: cells along the longest side of the box; the other sides in proportion.
        num_rays: directions per cell, spread evenly over the sphere.
        progress: called with (cells done, cells in all).
    """
    box_min, box_size, resolution = _lay_lattice(np.asarray(positions, np.float64), max_resolution)
    nx, ny, nz = resolution
    z, y, x = np.meshgrid(*((np.arange(n) + 0.5) / n for n in (nz, ny, nx)), indexing="ij")
    centres = box_min + box_size * np.stack([x, y, z], axis=-1).reshape(-1, 3)
    values, inside = _trace_cells(centres, positions, faces, num_rays, progress)
    values = values.reshape(nz, ny, nx, 9)
    inside = inside.reshape(nz, ny, nx)
    if inside.any() and not inside.all():
        cell = box_size / np.array(resolution)
        nearest = ndimage.distance_transform_edt(
            inside, sampling=tuple(cell[::-1]), return_distances=False, return_indices=True
        )
        values = values[tuple(nearest)]
    coeffs = np.zeros((nz, ny, nx, NUM_CHANNELS), np.float16)
    coeffs[..., :9] = values
    return OcclusionField(coeffs=coeffs, box_min=box_min, box_size=box_size)


def _lay_lattice(
    positions: NDArray[np.float64], max_resolution: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[int, int, int]]:
    """Box and number of cells: nearly cubic cells, one layer of centres just under the lowest point of the object."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    radius = float(np.max(np.linalg.norm(positions - 0.5 * (low + high), axis=1)))
    box_min, box_size = low - radius, high - low + 2.0 * radius
    cell = float(box_size.max()) / max_resolution
    counts = np.clip(np.rint(box_size / cell).astype(int), 2, max_resolution)
    cell_y = box_size[1] / counts[1]
    layer = np.floor((low[1] - box_min[1]) / cell_y)
    box_min[1] = low[1] - (layer + 0.5 + _GROUND_GAP) * cell_y
    return box_min, box_size, (int(counts[0]), int(counts[1]), int(counts[2]))


def _trace_cells(
    centres: NDArray[np.float64],
    positions: NDArray[np.floating],
    faces: NDArray[np.integer],
    num_rays: int,
    progress: Progress | None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """SH coefficients of the occlusion (n, 9) and whether each centre is inside (n,)."""
    corners = np.asarray(positions, np.float64)[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    caster = RayCaster(positions, faces)
    directions = _fibonacci_sphere(num_rays)
    weights = sh_basis(directions) * (4.0 * np.pi / num_rays)
    values = np.empty((len(centres), 9))
    inside = np.empty(len(centres), np.bool_)
    batch = max(1, (1 << 20) // num_rays)
    for start in range(0, len(centres), batch):
        part = slice(start, min(start + batch, len(centres)))
        n = part.stop - start
        rays = np.tile(directions, (n, 1))
        face = caster.closest(np.repeat(centres[part], num_rays, axis=0), rays).face
        hit = (face >= 0).reshape(n, num_rays)
        back = (np.einsum("ij,ij->i", face_normals[face], rays) > 0.0).reshape(n, num_rays) & hit
        values[part] = hit.astype(np.float64) @ weights
        inside[part] = back.sum(axis=1) > _INSIDE_SHARE * num_rays
        if progress is not None:
            progress(part.stop, len(centres))
    return values, inside


def _fibonacci_sphere(count: int) -> NDArray[np.float64]:
    """Evenly spread unit directions: (count, 3)."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = index * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
