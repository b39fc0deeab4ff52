"""The radiosity cache: converged reflected radiance on small patches of every surface.

Each cell sends cosine-distributed rays from points spread over it; the hit cells make a sparse transport matrix that Jacobi iteration
solves for all lights and channels at once. The cache lights the gather rays of the final pictures, so its own discretisation is
one bounce away from every pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from nearfield_server.virtual_lab.geometry import Cells
from nearfield_server.virtual_lab.sampling import Sampler
from nearfield_server.virtual_lab.tracer import DIMENSION_GATHER, DIMENSION_PIXEL, RAY_OFFSET, Tracer

# Jacobi stops when the largest change is below this share of the largest value; albedo <= 0.85 needs about 40 rounds at most.
CONVERGED = 1e-5
MAX_ITERATIONS = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class RadiosityCache:
    """The solution.

    Attributes:
        direct: (C, K) float64 irradiance from light k of unit radiance.
        indirect: (C, K, 3) float64 irradiance by way of other surfaces.
        reflected_radiance: (C, K, 3) float64, albedo / pi (direct + indirect), W/(sr m^2).
        exposed: (C,) float64 share of the cell that is not covered by something standing on it.
        iterations: Jacobi rounds used.
    """

    direct: NDArray[np.float64]
    indirect: NDArray[np.float64]
    reflected_radiance: NDArray[np.float64]
    exposed: NDArray[np.float64]
    iterations: int


def solve_radiosity(
    tracer: Tracer,
    cells: Cells,
    *,
    points: int,
    rays_per_point: int,
    seed: int,
    progress: Callable[[], None] = lambda: None,
) -> RadiosityCache:
    """Trace the transport of all cells and solve it.

    Args:
        tracer: the scene.
        cells: its cells.
        points: sample points per cell, a power of two.
        rays_per_point: gather rays from each, a power of two.
        seed: of the sampling pattern.
        progress: called once per sample point.
    """
    num_cells, num_lights = len(cells.area), tracer.num_lights
    hits = np.empty((num_cells, points * rays_per_point), dtype=np.int32)
    direct = np.zeros((num_cells, num_lights))
    covered = np.zeros((num_cells, points), dtype=bool)
    for point in range(points):
        found, is_covered, irradiance = _trace_point(tracer, cells, point, rays_per_point, seed)
        hits[:, point * rays_per_point : (point + 1) * rays_per_point] = found
        covered[:, point] = is_covered
        direct += np.where(is_covered[:, None], 0.0, irradiance)
        progress()
    exposed_points = np.maximum(points - covered.sum(axis=1), 1)
    hits[np.repeat(covered, rays_per_point, axis=1)] = num_cells
    direct /= exposed_points[:, None]
    weight = np.pi / (exposed_points * rays_per_point)
    indirect, iterations = _solve(hits, weight, direct, cells.albedo)
    return RadiosityCache(
        direct=direct,
        indirect=indirect,
        reflected_radiance=cells.albedo[:, None, :] / np.pi * (direct[:, :, None] + indirect),
        exposed=1.0 - covered.mean(axis=1),
        iterations=iterations,
    )


def _trace_point(
    tracer: Tracer, cells: Cells, point: int, rays: int, seed: int
) -> tuple[NDArray[np.int32], NDArray[np.bool_], NDArray[np.float64]]:
    """One sample point per cell: hit cells (C, rays) with C for "nothing", covered (C,), direct irradiance (C, K).

    A point of a quad cell whose ray meets the back of another quad lies inside a closed box that stands on the surface: it is covered.
    """
    mi, dr = tracer.backend.mi, tracer.backend.dr
    num_cells = len(cells.area)
    sampler = Sampler(tracer.backend, dr.arange(mi.UInt32, num_cells), seed)
    index = dr.opaque(mi.UInt32, point)
    u, v = sampler.pair(index, DIMENSION_PIXEL)
    is_triangle = mi.Bool(cells.is_triangle)
    folded = is_triangle & (u + v > 1)
    u, v = dr.select(folded, 1 - u, u), dr.select(folded, 1 - v, v)
    origin, edge_u, edge_v, face_normal = (
        mi.Vector3f(a.T.astype(np.float32)) for a in (cells.origin, cells.edge_u, cells.edge_v, cells.normal)
    )
    position = mi.Point3f(origin + u * edge_u + v * edge_v + RAY_OFFSET * face_normal)
    smooth = tracer.interpolated_normal(mi.UInt32(cells.face.astype(np.uint32)), u, v, is_triangle)
    normal = dr.select(is_triangle, smooth, mi.Normal3f(face_normal))
    irradiance = tracer.direct(position, normal, sampler, index, mi.Bool(True))
    found, covered = [], mi.Bool(np.zeros(num_cells, dtype=bool))
    for g in range(rays):
        direction = tracer.gather_direction(normal, *sampler.pair(index * rays + g, DIMENSION_GATHER))
        hit = tracer.intersect(position, direction)
        found.append(dr.select(hit.is_front, tracer.cell(hit), num_cells))
        owner = dr.gather(mi.Int32, tracer.face_object, hit.face, hit.is_back)
        covered |= hit.is_back & (owner < 0) & ~is_triangle
    dr.eval(found, covered, irradiance)
    return (
        np.stack([f.numpy() for f in found], axis=1).astype(np.int32),
        covered.numpy(),
        np.stack([e.numpy() for e in irradiance], axis=1).astype(np.float64),
    )


def _solve(
    hits: NDArray[np.int32],
    weight: NDArray[np.float64],
    direct: NDArray[np.float64],
    albedo: NDArray[np.float64],
) -> tuple[NDArray[np.float64], int]:
    """Indirect irradiance (C, K, 3): E = W (albedo / pi (E_direct + E)), W the ray-counted transport."""
    num_cells, num_rays = hits.shape
    transport = sparse.csr_matrix(
        (np.ones(hits.size, dtype=np.float32), hits.ravel(), np.arange(0, hits.size + 1, num_rays)),
        shape=(num_cells, num_cells + 1),
    )
    transport.sum_duplicates()
    num_lights = direct.shape[1]
    reflectance = np.vstack([albedo / np.pi, np.zeros((1, 3))]).astype(np.float32)[:, None, :]
    emitted = np.vstack([direct, np.zeros((1, num_lights))]).astype(np.float32)[:, :, None]
    row_weight = weight.astype(np.float32)[:, None]
    indirect = np.zeros((num_cells + 1, num_lights, 3), dtype=np.float32)
    iteration, is_converged = 0, False
    while iteration < MAX_ITERATIONS and not is_converged:
        iteration += 1
        leaving = (reflectance * (emitted + indirect)).reshape(num_cells + 1, -1)
        updated = (row_weight * (transport @ leaving)).reshape(num_cells, num_lights, 3)
        change = np.abs(updated - indirect[:-1]).max(axis=(0, 2))
        indirect[:-1] = updated
        is_converged = bool(np.all(change <= CONVERGED * np.abs(updated).max(axis=(0, 2))))
    return indirect[:-1].astype(np.float64), iteration
