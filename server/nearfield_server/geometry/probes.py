"""Probe rays: which texel each direction of a small cube map sees from a point (Rohmer et al. 2014, section 4.2).

The paper renders the room into a cube map per object and update; the texel behind each direction only changes when the
object moves, so it is traced once per pose.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.geometry.camera_view import RoomRays
from nearfield_server.geometry.texels import face_normals
from nearfield_server.radiometry.cube import cube_directions
from nearfield_server.records import RoomMesh, TexelGeometry

# A hit on a chart border lands on an uncovered texel; the covered texel of the same triangle is at most this far away.
_SEARCH_RANGE = 3
# Rays to a point end this share of the way before it: it lies on a surface.
_SHORT_OF_TARGET = 1e-4


class ProbeRays:
    """Traces cube-map directions against the room.

    Args:
        mesh: room.
        texels: its texel records.
    """

    def __init__(self, mesh: RoomMesh, texels: TexelGeometry) -> None:
        self._rays = RoomRays(mesh)
        self._normals = face_normals(mesh)
        self._corner_uv = mesh.uv[mesh.faces]
        self._texels = texels
        self._by_face = _FaceTexels(texels, len(mesh.faces))

    def trace(self, centre_world: NDArray[np.float64], resolution: int = 32) -> NDArray[np.int32]:
        """Texel seen along each direction.

        Args:
            centre_world: (3,) position, world frame.
            resolution: R, pixels along a cube edge.

        Returns:
            (6 R R,) int32 position in texel order, in the order of `radiometry.cube.cube_directions`; -1 where the ray
            leaves the room, hits a back face (black), or a triangle with no texel anywhere near.
        """
        directions = cube_directions(resolution)
        face, u, v = self._rays.first_face(np.asarray(centre_world, dtype=np.float64), directions)
        front = (face >= 0) & ((self._normals[face] * directions).sum(axis=1) < 0)
        result = np.full(len(directions), -1, dtype=np.int32)
        hit = np.flatnonzero(front)
        if hit.size:
            barycentric = np.stack([1.0 - u[hit] - v[hit], u[hit], v[hit]], axis=1).astype(np.float64)
            uv = np.einsum("nk,nkd->nd", barycentric, self._corner_uv[face[hit]])
            result[hit] = self._by_face.nearest(face[hit], uv)
        return result

    def sees(
        self, origin_world: NDArray[np.float64], targets_world: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """(n,) whether nothing of the room lies between the origin (3,) and each target (n, 3)."""
        offset = np.asarray(targets_world, dtype=np.float64) - origin_world
        distance = np.linalg.norm(offset, axis=1)
        starts = np.broadcast_to(np.asarray(origin_world, dtype=np.float64), offset.shape)
        directions = offset / np.maximum(distance, 1e-12)[:, None]
        return self._rays.free_sight(starts, directions, (1.0 - _SHORT_OF_TARGET) * distance)


class _FaceTexels:
    """Nearest texel of a given triangle to a UV position."""

    def __init__(self, texels: TexelGeometry, num_faces: int) -> None:
        self._texels = texels
        self._order = np.argsort(texels.face, kind="stable").astype(np.int32)
        self._start = np.searchsorted(texels.face[self._order], np.arange(num_faces + 1))

    def nearest(self, face: NDArray[np.int32], uv: NDArray[np.float64]) -> NDArray[np.int32]:
        """(n,) int32 positions in texel order.

        Triangles too small to own a texel take the nearest one of their neighbours; -1 where there is none around.
        """
        texels = self._texels
        points = uv * [texels.width, texels.height] - 0.5
        found = np.asarray(
            _nearest_of_face(points, face, texels.lookup, texels.face, _SEARCH_RANGE), dtype=np.int32
        )
        for index in np.flatnonzero(self._start[face + 1] > self._start[face]):
            if found[index] < 0:
                # The texels of thin triangles may lie farther away: look through all of them.
                members = self._order[self._start[face[index]] : self._start[face[index] + 1]]
                flat = texels.texel_index[members]
                offset = np.stack([flat % texels.width, flat // texels.width], axis=1) - points[index]
                found[index] = members[(offset * offset).sum(axis=1).argmin()]
        homeless = np.flatnonzero(found < 0)
        if homeless.size:
            any_face = np.full(homeless.size, -1, dtype=np.int32)
            found[homeless] = _nearest_of_face(
                points[homeless], any_face, texels.lookup, texels.face, _SEARCH_RANGE
            )
        return found


@njit(cache=True, nogil=True)
def _nearest_of_face(points, faces, lookup, texel_face, reach):  # type: ignore[no-untyped-def]  # pragma: no cover
    height, width = lookup.shape
    result = np.full(points.shape[0], -1, dtype=np.int32)
    for n in range(points.shape[0]):
        x, y = points[n, 0], points[n, 1]
        row, column = int(np.floor(y + 0.5)), int(np.floor(x + 0.5))
        best = np.inf
        for i in range(max(0, row - reach), min(height, row + reach + 1)):
            for j in range(max(0, column - reach), min(width, column + reach + 1)):
                texel = lookup[i, j]
                if texel >= 0 and (faces[n] < 0 or texel_face[texel] == faces[n]):
                    distance = (i - y) ** 2 + (j - x) ** 2
                    if distance < best:
                        best = distance
                        result[n] = texel
    return result
