"""Transfer coefficients of a virtual object: what each vertex makes of distant light, shadowed and lit by the object itself.

Per vertex with unit normal n, in object axes (Rohmer et al. 2014, Eq. 11; after Gierlinger et al. 2010):

    shadowed_k = integral V(w) max(0, n.w) Y_k(w) dw
    bounce1_k  = integral over blocked w of max(0, n.w) / pi * shadowed_k(hit point) dw
    bounce2_k  = the same of bounce1_k

so that for a Lambertian object of albedo a the whole transfer is `shadowed + a bounce1 + a^2 bounce2 / (1 - a q)`: the series
of self-interreflections
with its tail taken as geometric, q being the measured ratio of order 3 to order 2.

Differs from the paper: Rohmer et al. store the shadowed part only, which loses the light that an object sends to itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from nearfield_server.radiometry.sh import clamped_cosine_coeffs, sh_basis
from nearfield_server.scene.ray_caster import RayCaster, RayHits

SAMPLES_PER_VERTEX = {"preview": 100, "medium": 625, "high": 2500}
"""Visibility samples per vertex of each quality preset (Gierlinger et al. 2010)."""

# Start of a ray above its vertex, relative to the radius: far above the float32 rounding of the ray caster (about 1e-7), far
# below any detail that matters.
RAY_OFFSET = 2e-5
RAYS_PER_BATCH = 1 << 20

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Transfer:
    """Transfer coefficients per vertex, object axes.

    Attributes:
        shadowed: (V, 9) float64, direct light under self-shadowing.
        bounce1: (V, 9) float64, light reflected once by the object itself, per unit albedo.
        bounce2: (V, 9) float64, twice, per unit albedo squared.
        bounce_ratio: q in [0, 1), ratio of one order of reflection to the one before.
    """

    shadowed: NDArray[np.float64]
    bounce1: NDArray[np.float64]
    bounce2: NDArray[np.float64]
    bounce_ratio: float

    def total(self, albedo: float | NDArray[np.floating]) -> NDArray[np.float64]:
        """Transfer with all orders of self-interreflection.

        Args:
            albedo: one number, or (3,) for red, green and blue.

        Returns:
            (V, 9), or (V, 9, 3) for an albedo per channel.
        """
        a = np.asarray(albedo, np.float64)
        shadowed, bounce1, bounce2 = (
            x[..., None] if a.ndim else x for x in (self.shadowed, self.bounce1, self.bounce2)
        )
        total: NDArray[np.float64] = shadowed + a * bounce1 + a * a * bounce2 / (1.0 - a * self.bounce_ratio)
        return total


def compute_transfer(
    positions: NDArray[np.floating],
    normals: NDArray[np.floating],
    faces: NDArray[np.integer],
    *,
    samples_per_vertex: int,
    seed: int = 1,
    progress: Progress | None = None,
) -> Transfer:
    """Trace the transfer coefficients of a mesh against itself.

    Each vertex uses the same low-discrepancy pattern of cosine-distributed directions, shifted at random (Cranley-Patterson) so that
    neighbours do not share their error. The unshadowed part is taken in closed form and only the blocked part is sampled,
    which makes convex
    bodies exact. Back faces block light and reflect none. The mesh need not be closed.

    Args:
        positions: (V, 3) object frame, metres.
        normals: (V, 3) unit.
        faces: (F, 3), counter-clockwise from the front.
        samples_per_vertex: rays per vertex.
        seed: of the random shifts.
        progress: called with (vertices done, vertices in all).
    """
    matrix, shadowed = _trace(positions, normals, faces, samples_per_vertex, seed, progress)
    bounce1 = matrix @ shadowed
    bounce2 = matrix @ bounce1
    bounce3 = matrix @ bounce2
    energy = float(np.sum(bounce2 * bounce2))
    ratio = float(np.sum(bounce3 * bounce2)) / energy if energy > 0.0 else 0.0
    return Transfer(
        shadowed=shadowed, bounce1=bounce1, bounce2=bounce2, bounce_ratio=float(np.clip(ratio, 0.0, 0.999))
    )


def _trace(
    positions: NDArray[np.floating],
    normals: NDArray[np.floating],
    faces: NDArray[np.integer],
    num_samples: int,
    seed: int,
    progress: Progress | None,
) -> tuple[sparse.csr_matrix, NDArray[np.float64]]:
    """One-bounce matrix (V, V): irradiance on vertices per radiosity of vertices; and the shadowed transfer (V, 9)."""
    centre = 0.5 * (np.min(positions, axis=0) + np.max(positions, axis=0))
    # Rays are float32: keep coordinates small for models that lie far from their origin.
    local = np.asarray(positions, np.float64) - centre
    unit_normals = np.asarray(normals, np.float64)
    offset = RAY_OFFSET * float(np.max(np.linalg.norm(local, axis=1)))
    corners = local[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    caster = RayCaster(local, faces)

    count = len(local)
    shifts = np.random.default_rng(seed).random((count, 2))
    pattern = r2_pattern(num_samples)
    shadowed = clamped_cosine_coeffs(unit_normals)
    rows: list[sparse.csr_matrix] = []
    batch = max(1, RAYS_PER_BATCH // num_samples)
    for start in range(0, count, batch):
        part = slice(start, min(start + batch, count))
        n = part.stop - start
        directions = cosine_directions(unit_normals[part], shifts[part], pattern)
        origins = np.repeat(local[part] + offset * unit_normals[part], num_samples, axis=0)
        hits = caster.closest(origins, directions)
        vertex = np.repeat(np.arange(n), num_samples)
        blocked = np.flatnonzero(hits.face >= 0)
        lost = sh_basis(directions[blocked])
        per_vertex = sparse.csr_matrix(
            (np.ones(len(blocked)), (vertex[blocked], np.arange(len(blocked)))), (n, len(blocked))
        )
        shadowed[part] -= (np.pi / num_samples) * (per_vertex @ lost)
        facing = np.einsum("ij,ij->i", face_normals[hits.face[blocked]], directions[blocked]) < 0.0
        rows.append(bounce_rows(hits, blocked[facing], vertex, np.asarray(faces), (n, count), num_samples))
        if progress is not None:
            progress(part.stop, count)
    return sparse.vstack(rows, format="csr"), shadowed


def bounce_rows(
    hits: RayHits,
    lit: NDArray[np.intp],
    vertex: NDArray[np.intp],
    faces: NDArray[np.integer],
    shape: tuple[int, int],
    num_samples: int,
) -> sparse.csr_matrix:
    """Rows of the bounce matrix: each ray takes the barycentric mean of the face it hits, all rays of a vertex weigh the same."""
    u, v = hits.u[lit].astype(np.float64), hits.v[lit].astype(np.float64)
    weights = np.stack([1.0 - u - v, u, v], axis=1) / num_samples
    columns = faces[hits.face[lit]]
    return sparse.csr_matrix((weights.ravel(), (np.repeat(vertex[lit], 3), columns.ravel())), shape)


def r2_pattern(count: int) -> NDArray[np.float64]:
    """First points of the R2 sequence (Roberts 2018) on the unit torus: (count, 2)."""
    plastic = 1.324717957244746
    steps = np.array([1.0 / plastic, 1.0 / plastic**2])
    return np.asarray((0.5 + np.arange(count)[:, None] * steps) % 1.0)


def cosine_directions(
    normals: NDArray[np.float64], shifts: NDArray[np.float64], pattern: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Directions of density cos / pi about each normal: (n, 3), (n, 2), (s, 2) -> (n * s, 3), vertex by vertex."""
    points = (pattern[None] + shifts[:, None]) % 1.0
    radius, angle = np.sqrt(points[..., 0]), 2.0 * np.pi * points[..., 1]
    local = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - points[..., 0])], axis=-1)
    return np.asarray(np.einsum("vsk,vkj->vsj", local, _frames(normals)).reshape(-1, 3))


def _frames(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Orthonormal rows (tangent, bitangent, normal) without singularity (Duff et al. 2017): (n, 3) -> (n, 3, 3)."""
    x, y, z = normals.T
    sign = np.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    tangent = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    bitangent = np.stack([b, sign + y * y * a, -y], axis=1)
    return np.stack([tangent, bitangent, normals], axis=1)
