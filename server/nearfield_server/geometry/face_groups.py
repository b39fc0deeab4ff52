"""Connected surfaces of the room: which triangles one camera neighbourhood may show as "the same surface"."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from nearfield_server.geometry.texels import face_normals
from nearfield_server.records import RoomMesh

# Faces that share an edge belong together up to this angle: curved furniture is one surface, a box corner is not.
SMOOTH_ANGLE = np.radians(30.0)
# Positions closer than this share of the room's extent are one point.
_WELD = 1e-5
# Coplanar pieces that only touch (T-junctions) are joined pairwise up to this many per plane.
_MAX_PIECES = 1500


def face_groups(mesh: RoomMesh) -> NDArray[np.int32]:
    """Surface number of each triangle, (F,) int32 from 0.

    Two triangles of one material are of one surface when they share an edge across which the surface turns by less than
    `SMOOTH_ANGLE`, or when they are coplanar and touch. A lamp panel flush in the ceiling is of another material and
    therefore of another surface.
    """
    normals = face_normals(mesh)
    pairs = _smooth_pairs(mesh, normals)
    pieces = _components(len(mesh.faces), pairs)
    return _components(len(mesh.faces), np.concatenate([pairs, _touching_pairs(mesh, normals, pieces)]))


def _components(count: int, pairs: NDArray[np.int64]) -> NDArray[np.int32]:
    ones = np.ones(len(pairs), dtype=np.int8)
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int32)


def _weld_length(mesh: RoomMesh) -> float:
    return _WELD * float(np.ptp(mesh.positions, axis=0).max())


def welded_corners(mesh: RoomMesh) -> NDArray[np.int64]:
    """(F, 3) int64 number of the point at each corner; corners of one position share it whatever their vertices."""
    quantised = np.rint(mesh.positions / _weld_length(mesh)).astype(np.int64)
    points = np.unique(quantised, axis=0, return_inverse=True)[1].reshape(-1)
    return np.asarray(points[mesh.faces], dtype=np.int64)


def _smooth_pairs(mesh: RoomMesh, normals: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n, 2) pairs of triangles of one material across a shared edge that is not a crease."""
    welded = welded_corners(mesh)
    edges = np.sort(np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]]), axis=1)
    face = np.tile(np.arange(len(mesh.faces)), 3)
    key = edges[:, 0] * (int(welded.max()) + 1) + edges[:, 1]
    order = np.lexsort((mesh.face_material[face], key))
    key, face = key[order], face[order]
    first, second = face[:-1], face[1:]
    joined = (key[:-1] == key[1:]) & (mesh.face_material[first] == mesh.face_material[second])
    joined &= (normals[first] * normals[second]).sum(axis=1) > np.cos(SMOOTH_ANGLE)
    return np.stack([first[joined], second[joined]], axis=1)


def _touching_pairs(
    mesh: RoomMesh, normals: NDArray[np.float64], pieces: NDArray[np.int32]
) -> NDArray[np.int64]:
    """(n, 2) pairs of coplanar triangles of one material whose pieces touch without sharing an edge."""
    weld = _weld_length(mesh)
    corners = mesh.positions[mesh.faces]
    offset = (normals * corners[:, 0]).sum(axis=1)
    plane = np.column_stack(
        [np.rint(normals * 1e3), np.rint(offset / (10 * weld)), mesh.face_material]
    ).astype(np.int64)
    plane_id = np.unique(plane, axis=0, return_inverse=True)[1].reshape(-1)
    low, high = corners.min(axis=1) - weld, corners.max(axis=1) + weld
    found: list[NDArray[np.int64]] = [np.zeros((0, 2), dtype=np.int64)]
    for members in np.split(np.argsort(plane_id, kind="stable"), np.cumsum(np.bincount(plane_id))[:-1]):
        if not 1 < len(members) <= _MAX_PIECES or len(np.unique(pieces[members])) == 1:
            continue
        touch = np.all(
            (low[members][:, None] <= high[members][None]) & (high[members][:, None] >= low[members][None]),
            axis=2,
        )
        first, second = np.nonzero(np.triu(touch, 1))
        found.append(np.stack([members[first], members[second]], axis=1))
    return np.concatenate(found)
