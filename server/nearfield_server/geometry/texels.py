"""Texel geometry: world position, normal and area of every covered atlas texel (Rohmer et al. 2014, section 4.1).

A texel is covered when its centre lies inside a triangle (top-left rule), and stands for an equal share of that
triangle's area: the map from UV to the surface is affine within a triangle, so its Jacobian is constant there, and the
shares sum to the true area exactly.

Differs from the paper: triangles that contain no texel centre (slivers, tiny emitters) claim the nearest free texel, so
that their light is not lost; inside a chart, where none is free, the texel at their place takes over their area if it is of
the same material and faces the same way. Gutter texels are kept as a list with zero area instead of being written into the atlas.
"""

from __future__ import annotations

from importlib import import_module
from typing import Literal

import numpy as np
import structlog
from numba import njit
from numpy.typing import NDArray

from nearfield_server.errors import GraphicsError
from nearfield_server.geometry.morton import morton_code
from nearfield_server.records import RoomMesh, TexelGeometry
from nearfield_server.scene.uv_raster import cover_texels

_LOGGER = structlog.get_logger(__name__)
GUTTER_RANGE = 2
# How far (texels) a triangle without a texel centre may look for a free texel.
_CLAIM_RANGE = 4
# A texel takes over the area of a triangle without texel when their normals are within 60 degrees.
_HOST_COSINE = 0.5
Rasteriser = Literal["auto", "gl", "cpu"]


def rasterise_texels(mesh: RoomMesh, atlas_size: int, *, rasteriser: Rasteriser = "auto") -> TexelGeometry:
    """Build the texel records of a room.

    Args:
        mesh: room with an atlas layout.
        atlas_size: height and width of the atlas, texels.
        rasteriser: "cpu" (numba), "gl" (OpenGL), or "auto": OpenGL where a hardware renderer is there, else CPU.

    Returns:
        Records in Morton order (neighbours in the atlas stay near each other in memory).

    Raises:
        GraphicsError: "gl" was asked for and there is no OpenGL context.
    """
    owner = None
    if rasteriser != "cpu":
        owner = _cover_on_gpu(mesh, atlas_size, required=rasteriser == "gl")
    if owner is None:
        owner = cover_texels(mesh.uv, mesh.faces, atlas_size, atlas_size).face
    return texels_from_coverage(mesh, owner)


def _cover_on_gpu(mesh: RoomMesh, atlas_size: int, *, required: bool) -> NDArray[np.int32] | None:
    # Imported by name: processes that never ask for it (the gateway) must not depend on OpenGL.
    context_module = import_module("nearfield_server.gpu.context")
    raster_module = import_module("nearfield_server.gpu.atlas_raster")
    try:
        with context_module.open_context() as context:
            if context.is_software and not required:
                return None
            owner: NDArray[np.int32] = raster_module.cover_texels_gl(
                context, mesh.uv, mesh.faces, atlas_size, atlas_size
            )
            return owner
    except GraphicsError:
        if required:
            raise
        return None


def texels_from_coverage(mesh: RoomMesh, owner: NDArray[np.int32]) -> TexelGeometry:
    """Texel records from the triangle that owns each texel.

    Args:
        mesh: room.
        owner: (height, width) int32 triangle index or -1.
    """
    height, width = owner.shape
    owner = owner.copy()
    counts = np.bincount(owner[owner >= 0], minlength=len(mesh.faces))
    claimed, homeless = _claim(owner, mesh, np.flatnonzero(counts == 0))
    rows, columns = np.nonzero(owner >= 0)
    order = np.argsort(morton_code(rows, columns), kind="stable")
    rows, columns = rows[order], columns[order]
    face = owner[rows, columns]
    barycentric = _barycentric(mesh, face, rows, columns, height, width)
    barycentric[claimed[rows, columns]] = 1 / 3
    corners = mesh.faces[face]
    position = np.einsum("nk,nkd->nd", barycentric, mesh.positions[corners])
    normal = _shading_normals(mesh, face, np.einsum("nk,nkd->nd", barycentric, mesh.normals[corners]))
    texel_index = (rows * width + columns).astype(np.int32)
    lookup = np.full(height * width, -1, dtype=np.int32)
    lookup[texel_index] = np.arange(len(texel_index), dtype=np.int32)
    lookup = lookup.reshape(height, width)
    gutter_texel, gutter_source = find_gutter(lookup)
    return TexelGeometry(
        height=height,
        width=width,
        texel_index=texel_index,
        position=np.ascontiguousarray(position, dtype=np.float32),
        normal=np.ascontiguousarray(normal, dtype=np.float32),
        area=_shared_areas(mesh, face, homeless, lookup).astype(np.float32),
        face=np.ascontiguousarray(face, dtype=np.int32),
        lookup=lookup,
        gutter_texel=gutter_texel,
        gutter_source=gutter_source,
    )


def face_areas(mesh: RoomMesh) -> NDArray[np.float64]:
    """(F,) float64 area of each triangle, m^2."""
    return np.asarray(0.5 * np.linalg.norm(_face_crosses(mesh), axis=1))


def face_normals(mesh: RoomMesh) -> NDArray[np.float64]:
    """(F, 3) float64 unit geometric normal of each triangle."""
    crosses = _face_crosses(mesh)
    return np.asarray(crosses / np.linalg.norm(crosses, axis=1, keepdims=True))


def find_gutter(
    lookup: NDArray[np.int32], num_rings: int = GUTTER_RANGE
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Uncovered texels near charts and the texel each one repeats (8-neighbour dilation).

    Args:
        lookup: (height, width) int32 texel positions or -1.
        num_rings: range in texels.

    Returns:
        Flat indices (G,) int32 and sources (G,) int32. Edge neighbours are preferred to corner neighbours.
    """
    grown = np.pad(lookup, 1, constant_values=-1)
    shifts = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
    height, width = lookup.shape
    for _ in range(num_rings):
        source = grown.copy()
        inner = grown[1:-1, 1:-1]
        for row_shift, column_shift in shifts:
            neighbour = source[
                1 + row_shift : 1 + row_shift + height, 1 + column_shift : 1 + column_shift + width
            ]
            np.copyto(inner, neighbour, where=(inner < 0) & (neighbour >= 0))
    inner = grown[1:-1, 1:-1]
    gutter = np.flatnonzero((lookup < 0) & (inner >= 0)).astype(np.int32)
    return gutter, np.ascontiguousarray(inner.reshape(-1)[gutter])


def _face_crosses(mesh: RoomMesh) -> NDArray[np.float64]:
    corners = mesh.positions[mesh.faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _barycentric(
    mesh: RoomMesh,
    face: NDArray[np.int32],
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    height: int,
    width: int,
) -> NDArray[np.float64]:
    """(N, 3) float64 barycentric coordinates of the texel centres in their triangles, clamped to the triangle."""
    corners = mesh.uv[mesh.faces[face]]
    origin = corners[:, 0]
    first, second = corners[:, 1] - origin, corners[:, 2] - origin
    offset = np.stack([(columns + 0.5) / width, (rows + 0.5) / height], axis=1) - origin
    determinant = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    b = (offset[:, 0] * second[:, 1] - offset[:, 1] * second[:, 0]) / determinant
    c = (first[:, 0] * offset[:, 1] - first[:, 1] * offset[:, 0]) / determinant
    # Snapping lets a centre lie up to 1/4096 texel outside; near needle tips that would extrapolate far.
    coordinates = np.clip(np.stack([1 - b - c, b, c], axis=1), 0.0, 1.0)
    return np.asarray(coordinates / coordinates.sum(axis=1, keepdims=True))


def _shading_normals(
    mesh: RoomMesh, face: NDArray[np.int32], interpolated: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Unit normals; the geometric one where the interpolated one vanishes or points behind the surface."""
    geometric = face_normals(mesh)[face]
    length = np.linalg.norm(interpolated, axis=1, keepdims=True)
    usable = (length[:, 0] > 1e-6) & ((interpolated * geometric).sum(axis=1) > 0)
    return np.where(usable[:, None], interpolated / np.maximum(length, 1e-6), geometric)


def _shared_areas(
    mesh: RoomMesh, face: NDArray[np.int32], homeless: NDArray[np.int64], lookup: NDArray[np.int32]
) -> NDArray[np.float64]:
    """(N,) float64 area of each texel: its share of its triangle, and all of the homeless triangles at its place."""
    areas, normals = face_areas(mesh), face_normals(mesh)
    shares = np.asarray((areas / np.maximum(np.bincount(face, minlength=len(mesh.faces)), 1))[face])
    if not len(homeless):
        return shares
    height, width = lookup.shape
    centres = np.clip(
        mesh.uv[mesh.faces[homeless]].mean(axis=1) * [width, height], 0, [width - 1, height - 1]
    )
    host = lookup[centres[:, 1].astype(np.int64), centres[:, 0].astype(np.int64)]
    host_face = face[host]
    kept = (host >= 0) & (mesh.face_material[host_face] == mesh.face_material[homeless])
    kept &= (normals[host_face] * normals[homeless]).sum(axis=1) > _HOST_COSINE
    np.add.at(shares, host[kept], areas[homeless[kept]])
    if not kept.all():
        lost = homeless[~kept]
        _LOGGER.warning(
            "triangles too small for the atlas give no light; use a larger atlas",
            lost=len(lost),
            of=len(mesh.faces),
            area=float(areas[lost].sum()),
        )
    return shares


def _claim(
    owner: NDArray[np.int32], mesh: RoomMesh, empty_faces: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Give each triangle without a texel the nearest free one; returns the claimed texels and the triangles left over."""
    height, width = owner.shape
    centres = mesh.uv[mesh.faces[empty_faces]].mean(axis=1) * [width, height]
    claimed = np.zeros(owner.shape, dtype=np.bool_)
    is_homeless = np.asarray(
        _claim_nearest(owner, claimed, empty_faces, centres, _CLAIM_RANGE), dtype=np.bool_
    )
    return claimed, empty_faces[is_homeless]


@njit(cache=True, nogil=True)
def _claim_nearest(owner, claimed, empty_faces, centres, reach):  # type: ignore[no-untyped-def]  # pragma: no cover
    height, width = owner.shape
    homeless = np.zeros(empty_faces.shape[0], dtype=np.bool_)
    for k in range(empty_faces.shape[0]):
        x, y = centres[k, 0] - 0.5, centres[k, 1] - 0.5
        best, best_row, best_column = np.inf, -1, -1
        for row in range(max(0, int(y) - reach), min(height, int(y) + reach + 2)):
            for column in range(max(0, int(x) - reach), min(width, int(x) + reach + 2)):
                if owner[row, column] < 0:
                    distance = (row - y) ** 2 + (column - x) ** 2
                    if distance < best:
                        best, best_row, best_column = distance, row, column
        if best_row < 0:
            homeless[k] = True
            continue
        owner[best_row, best_column] = empty_faces[k]
        claimed[best_row, best_column] = True
    return homeless
