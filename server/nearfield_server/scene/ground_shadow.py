"""What a virtual object loses because it darkens the surface that it stands on.

The SH of the indirect light are taken in the empty room, so they hold the light of the bare table under the object. Once the
object stands there, it keeps light from the table around its foot, and sends some of its own. Both are linear in the light
that arrives, lamps included. Per vertex, in object axes, for a plane of reflectance 1 and light Y_k:

    change_k(x) = a (irradiance of x by the object under Y_k) - integral over w from x that the object blocks of max(0, n.w) Y_k(w) dw
    ground_k    = - integral over w that meets the plane of change_k(hit) / pi max(0, n.w) dw

The irradiance of a standing object is that of its transfer minus the plane's reflectance times `ground` times the SH of all
light. The plane is horizontal (+y up) through the lowest point of the model. Light that goes back and forth between plane and
object more than once is left out.

Rohmer et al. 2014 name the missing shadow of virtual objects as a reason for indirect light that is too bright (section 6.2).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from nearfield_server.radiometry.sh import sh_basis
from nearfield_server.scene.ray_caster import RayCaster
from nearfield_server.scene.transfer import (
    RAY_OFFSET,
    RAYS_PER_BATCH,
    Progress,
    bounce_rows,
    cosine_directions,
    r2_pattern,
)

_MAP_SIZE: Final = 48
"""Points per side of the map of the plane."""
_MAP_MARGIN: Final = 1.0
"""How far the map reaches beyond the object, in bounding radii; there the change is a few per cent."""
_MAP_RAYS: Final = 256
_CONTACT_REACH: Final = 0.2
"""Radii of gap between object and surface at which the ground shadow is gone."""
_UPRIGHT: Final = 0.99
_TILTED: Final = 0.9
"""Cosines of the tilt at which the ground shadow applies fully and not at all."""
_BOUNCES: Final = 3
"""Reflections of the loss on the object itself that are followed."""


def compute_ground_shadow(
    positions: NDArray[np.floating],
    normals: NDArray[np.floating],
    faces: NDArray[np.integer],
    albedo: float,
    transfer: NDArray[np.float64],
    *,
    samples_per_vertex: int,
    seed: int = 1,
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Trace the loss of a mesh that stands on a plane.

    Args:
        positions: (V, 3) object frame, metres, +y up.
        normals: (V, 3) unit.
        faces: (F, 3).
        albedo: of the object, mean over the channels; it lights the plane again.
        transfer: (V, 9) `Transfer.total(albedo)`.
        samples_per_vertex: rays per vertex.
        seed: of the random shifts.
        progress: called with (vertices done, vertices in all).

    Returns:
        (V, 9) float64 per unit reflectance of the plane, to be subtracted from the transfer where the object stands on a
        surface; self-interreflection included.
    """
    low, high = np.min(positions, axis=0), np.max(positions, axis=0)
    centre = 0.5 * (low + high)
    local = np.asarray(positions, np.float64) - centre
    radius = float(np.max(np.linalg.norm(local, axis=1)))
    plane = _Plane(low - centre, high - centre, radius)
    caster = RayCaster(local, faces)
    offset = RAY_OFFSET * radius
    up = np.tile([0.0, 1.0, 0.0], (plane.num_points, 1))
    ground = _Rays(caster, plane, plane.points, up, np.asarray(faces), len(local), offset, seed)
    blocked, _, plane_from_object = ground.trace(_MAP_RAYS, None)
    unit_normals = np.asarray(normals, np.float64)
    vertex = _Rays(caster, plane, local, unit_normals, np.asarray(faces), len(local), offset, seed)
    _, object_from_plane, self_bounce = vertex.trace(samples_per_vertex, progress)
    lost = plane.edge_fade[:, None] * (blocked - albedo * (plane_from_object @ transfer))
    loss = object_from_plane @ lost
    # Light that did not reach one part of the object is missing from what that part sends to another.
    total = loss
    for _ in range(_BOUNCES):
        total = loss + albedo * (self_bounce @ total)
    return np.asarray(total)


def ground_reflectance(
    low: NDArray[np.floating],
    high: NDArray[np.floating],
    radius: float,
    world_from_object: NDArray[np.floating],
    room: RayCaster,
    face_albedo: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Reflectance of the surface that the object stands on; black where it floats or lies tilted.

    Five rays go down from the object's base (its middle and half-way to its corners). The client computes the same.

    Args:
        low: (3,) lowest corner of the bounding box, object axes.
        high: (3,) highest corner of it.
        radius: of the bounding sphere, metres.
        world_from_object: (4, 4).
        room: ray caster over the room, world axes.
        face_albedo: (F, 3) of the room's triangles.

    Returns:
        (3,) in [0, 1]: the mean over the rays, falling linearly with the gap over `_CONTACT_REACH` radii.
    """
    pose = np.asarray(world_from_object, np.float64)
    tilt = np.clip((pose[1, 1] - _TILTED) / (_UPRIGHT - _TILTED), 0.0, 1.0)
    middle, half = 0.5 * (np.asarray(low) + np.asarray(high)), 0.25 * (np.asarray(high) - np.asarray(low))
    corners = np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]], np.float64) * half[[0, 2]]
    base = np.stack([middle[0] + corners[:, 0], np.full(5, float(low[1])), middle[2] + corners[:, 1]], axis=1)
    reach = _CONTACT_REACH * radius
    origins = base @ pose[:3, :3].T + pose[:3, 3] + np.array([0.0, reach, 0.0])
    hits = room.closest(origins, np.tile([0.0, -1.0, 0.0], (5, 1)))
    gap = np.abs(hits.distance.astype(np.float64) - reach)
    share = np.clip(1.0 - gap / reach, 0.0, 1.0)
    return np.asarray(tilt * np.mean(share[:, None] * np.asarray(face_albedo, np.float64)[hits.face], axis=0))


class _Plane:
    """The plane under the object with a square grid of points around it, coordinates relative to the object's centre."""

    def __init__(self, low: NDArray[np.float64], high: NDArray[np.float64], radius: float) -> None:
        self.height = float(low[1])
        self._low = low[[0, 2]] - _MAP_MARGIN * radius
        self._cell = (high[[0, 2]] - low[[0, 2]] + 2.0 * _MAP_MARGIN * radius) / (_MAP_SIZE - 1)
        step = np.arange(_MAP_SIZE)
        x, z = np.meshgrid(
            self._low[0] + step * self._cell[0], self._low[1] + step * self._cell[1], indexing="ij"
        )
        self.points = np.stack([x.ravel(), np.full(x.size, self.height), z.ravel()], axis=1)
        self.num_points = self.points.shape[0]
        from_edge = np.minimum(step, _MAP_SIZE - 1 - step) / (0.15 * _MAP_SIZE)
        fade = np.clip(from_edge, 0.0, 1.0)
        self.edge_fade = np.minimum(fade[:, None], fade[None]).ravel()

    def meet(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.float64]]:
        """Which rays meet the map, and the four grid points (n, 4) with bilinear weights (n, 4) of each that does."""
        down = directions[:, 1] < -1e-9
        # Rays that start in the plane (or a hair below it, where the object touches it) meet it at once.
        distance = np.maximum((self.height - origins[:, 1]) / np.where(down, directions[:, 1], -1.0), 0.0)
        hit = origins[:, [0, 2]] + distance[:, None] * directions[:, [0, 2]]
        where = (hit - self._low) / self._cell
        meets = down & np.all((where >= 0.0) & (where <= _MAP_SIZE - 1), axis=1)
        where = where[meets]
        first = np.minimum(where.astype(np.int64), _MAP_SIZE - 2)
        u, v = (where - first).T
        corner = first[:, 0] * _MAP_SIZE + first[:, 1]
        points = corner[:, None] + np.array([0, 1, _MAP_SIZE, _MAP_SIZE + 1])
        weights = np.stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v], axis=1)
        return meets, points, weights


class _Rays:
    """Cosine-distributed rays from points: what share of them meets the plane and the object."""

    def __init__(
        self,
        caster: RayCaster,
        plane: _Plane,
        origins: NDArray[np.float64],
        normals: NDArray[np.float64],
        faces: NDArray[np.integer],
        num_vertices: int,
        offset: float,
        seed: int,
    ) -> None:
        self._caster, self._plane, self._faces = caster, plane, faces
        self._origins = origins + offset * normals
        self._normals, self._num_vertices = normals, num_vertices
        self._shifts = np.random.default_rng(seed).random((len(origins), 2))

    def trace(
        self, num_rays: int, progress: Progress | None
    ) -> tuple[NDArray[np.float64], sparse.csr_matrix, sparse.csr_matrix]:
        """Cosine integral of Y_k over blocked rays (n, 9); shares of rays that meet points of the plane (n, P) and vertices (n, V)."""
        count = len(self._origins)
        pattern = r2_pattern(num_rays)
        blocked_sh = np.zeros((count, 9))
        plane_rows: list[sparse.csr_matrix] = []
        object_rows: list[sparse.csr_matrix] = []
        batch = max(1, RAYS_PER_BATCH // num_rays)
        for start in range(0, count, batch):
            part = slice(start, min(start + batch, count))
            n = part.stop - start
            directions = cosine_directions(self._normals[part], self._shifts[part], pattern)
            origins = np.repeat(self._origins[part], num_rays, axis=0)
            ray_origin = np.repeat(np.arange(n), num_rays)
            found = self._caster.closest(origins, directions)
            blocked = np.flatnonzero(found.face >= 0)
            free = np.flatnonzero(found.face < 0)
            np.add.at(blocked_sh[part], ray_origin[blocked], np.pi / num_rays * sh_basis(directions[blocked]))
            meets, points, weights = self._plane.meet(origins[free], directions[free])
            landed = free[meets]
            plane_rows.append(
                sparse.csr_matrix(
                    (weights.ravel() / num_rays, (np.repeat(ray_origin[landed], 4), points.ravel())),
                    (n, self._plane.num_points),
                )
            )
            shape = (n, self._num_vertices)
            object_rows.append(bounce_rows(found, blocked, ray_origin, self._faces, shape, num_rays))
            if progress is not None:
                progress(part.stop, count)
        return blocked_sh, sparse.vstack(plane_rows, format="csr"), sparse.vstack(object_rows, format="csr")
