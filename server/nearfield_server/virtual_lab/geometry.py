"""Flat arrays of a scene: triangles, per-triangle tables and radiosity cells. Pure numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nearfield_server.virtual_lab.model import Quad, Scene

# Corners of a quad as multiples of (e1, e2), and its two triangles: (0, 1, 2), (0, 2, 3).
QUAD_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
QUAD_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


@dataclass(frozen=True, slots=True, kw_only=True)
class Geometry:
    """One triangle soup of the room (and the virtual objects).

    Triangles 2 q and 2 q + 1 are quad q; the triangles of the objects follow. Every triangle lies in one "surface": a quad with
    cells_u x cells_v radiosity cells, or an object triangle that is one cell.

    Attributes:
        positions: (V, 3) float64 world. normals: (V, 3) float64 unit shading normals. faces: (F, 3) int32.
        face_normal: (F, 3) float64 unit geometric normals.
        face_albedo: (F, 3) float64.
        face_light: (F,) int32, light index or -1.
        face_object: (F,) int32, object index or -1.
        face_origin: (F, 3) float64; face_u, face_v: (F, 3) float64 with u = dot(p - origin, face_u) in [0, 1] on a quad.
        cells_u, cells_v: (F,) int32.
        face_cell: (F,) int32, first cell of the surface.
        num_cells: total count.
    """

    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    faces: NDArray[np.int32]
    face_normal: NDArray[np.float64]
    face_albedo: NDArray[np.float64]
    face_light: NDArray[np.int32]
    face_object: NDArray[np.int32]
    face_origin: NDArray[np.float64]
    face_u: NDArray[np.float64]
    face_v: NDArray[np.float64]
    cells_u: NDArray[np.int32]
    cells_v: NDArray[np.int32]
    face_cell: NDArray[np.int32]
    num_cells: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """Radiosity cells in the order of `Geometry.face_cell`.

    Attributes:
        face: (C,) int32, a triangle of the cell's surface.
        origin, edge_u, edge_v: (C, 3) float64; a quad cell is `origin + u edge_u + v edge_v`, an object cell the triangle u + v <= 1.
        area: (C,) float64 m^2. normal: (C, 3) float64. albedo: (C, 3) float64. light: (C,) int32.
        is_triangle: (C,) bool.
    """

    face: NDArray[np.int32]
    origin: NDArray[np.float64]
    edge_u: NDArray[np.float64]
    edge_v: NDArray[np.float64]
    area: NDArray[np.float64]
    normal: NDArray[np.float64]
    albedo: NDArray[np.float64]
    light: NDArray[np.int32]
    is_triangle: NDArray[np.bool_]

    @property
    def centre(self) -> NDArray[np.float64]:
        """(C, 3) float64 centroids."""
        share = np.where(self.is_triangle, 1.0 / 3.0, 0.5)[:, None]
        return np.asarray(self.origin + share * (self.edge_u + self.edge_v))


def cell_counts(quad: Quad) -> tuple[int, int]:
    """Cells along e1 and e2, so that none is longer than `quad.cell_size`."""
    return tuple(max(1, int(np.ceil(np.linalg.norm(e) / quad.cell_size - 1e-9))) for e in (quad.e1, quad.e2))  # type: ignore[return-value]


def build_geometry(scene: Scene, *, with_objects: bool) -> Geometry:
    """Triangles and tables of the room, with or without the virtual objects.

    The cells of the empty room come first, so they have the same indices in both.
    """
    quads = scene.quads
    p0, e1, e2 = (np.stack([getattr(q, name) for q in quads]) for name in ("p0", "e1", "e2"))
    quad_normal = np.stack([q.normal for q in quads])
    counts = np.array([cell_counts(q) for q in quads], dtype=np.int32)
    first_cell = np.concatenate([[0], np.cumsum(counts[:, 0] * counts[:, 1])])
    corners = p0[:, None] + QUAD_CORNERS[:, :1] * e1[:, None] + QUAD_CORNERS[:, 1:] * e2[:, None]
    positions, normals = [corners.reshape(-1, 3)], [np.repeat(quad_normal, 4, axis=0)]
    faces = [(np.arange(len(quads))[:, None, None] * 4 + QUAD_TRIANGLES).reshape(-1, 3)]
    light = [np.repeat([q.light for q in quads], 2)]
    albedo = [np.repeat([scene.materials[q.material] for q in quads], 2, axis=0)]
    owner = [np.full(2 * len(quads), -1)]
    origin, u_axis, v_axis = np.repeat(p0, 2, axis=0), np.repeat(e1, 2, axis=0), np.repeat(e2, 2, axis=0)
    cells_u, cells_v = np.repeat(counts[:, 0], 2), np.repeat(counts[:, 1], 2)
    cell = np.repeat(first_cell[:-1], 2)
    total = int(first_cell[-1])
    for index, item in enumerate(scene.objects if with_objects else ()):
        offset = sum(len(block) for block in positions)
        positions.append(item.positions_world)
        normals.append(item.normals_world)
        faces.append(item.faces + offset)
        count = len(item.faces)
        light.append(np.full(count, -1))
        owner.append(np.full(count, index))
        albedo.append(np.broadcast_to(item.albedo, (count, 3)))
        zero, one = np.zeros((count, 3)), np.ones(count)
        origin, u_axis, v_axis = (np.concatenate([a, zero]) for a in (origin, u_axis, v_axis))
        cells_u, cells_v = np.concatenate([cells_u, one]), np.concatenate([cells_v, one])
        cell = np.concatenate([cell, total + np.arange(count)])
        total += count
    all_positions, all_faces = np.concatenate(positions), np.concatenate(faces).astype(np.int32)
    corner = all_positions[all_faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])

    def reciprocal(axis: NDArray[np.float64]) -> NDArray[np.float64]:
        square = np.sum(axis**2, axis=1, keepdims=True)
        return np.asarray(axis / np.where(square > 0, square, 1.0))

    return Geometry(
        positions=all_positions,
        normals=np.concatenate(normals),
        faces=all_faces,
        face_normal=cross / np.linalg.norm(cross, axis=1, keepdims=True),
        face_albedo=np.concatenate(albedo).astype(np.float64),
        face_light=np.concatenate(light).astype(np.int32),
        face_object=np.concatenate(owner).astype(np.int32),
        face_origin=origin,
        face_u=reciprocal(u_axis),
        face_v=reciprocal(v_axis),
        cells_u=cells_u.astype(np.int32),
        cells_v=cells_v.astype(np.int32),
        face_cell=cell.astype(np.int32),
        num_cells=total,
    )


def build_cells(scene: Scene, geometry: Geometry) -> Cells:
    """The radiosity cells of a geometry, quad cells first (u fastest), then one per object triangle."""
    num_quads = len(scene.quads)
    face, origin, edge_u, edge_v = [], [], [], []
    for index, q in enumerate(scene.quads):
        num_u, num_v = int(geometry.cells_u[2 * index]), int(geometry.cells_v[2 * index])
        v_index, u_index = np.meshgrid(np.arange(num_v), np.arange(num_u), indexing="ij")
        du, dv = q.e1 / num_u, q.e2 / num_v
        origin.append(q.p0 + u_index.reshape(-1, 1) * du + v_index.reshape(-1, 1) * dv)
        edge_u.append(np.broadcast_to(du, (num_u * num_v, 3)))
        edge_v.append(np.broadcast_to(dv, (num_u * num_v, 3)))
        face.append(np.full(num_u * num_v, 2 * index))
    triangles = np.arange(2 * num_quads, len(geometry.faces))
    corner = geometry.positions[geometry.faces[triangles]]
    face.append(triangles)
    origin.append(corner[:, 0])
    edge_u.append(corner[:, 1] - corner[:, 0])
    edge_v.append(corner[:, 2] - corner[:, 0])
    all_face = np.concatenate(face).astype(np.int32)
    all_u, all_v = np.concatenate(edge_u), np.concatenate(edge_v)
    is_triangle = all_face >= 2 * num_quads
    area = np.linalg.norm(np.cross(all_u, all_v), axis=1) * np.where(is_triangle, 0.5, 1.0)
    return Cells(
        face=all_face,
        origin=np.concatenate(origin),
        edge_u=all_u,
        edge_v=all_v,
        area=area,
        normal=geometry.face_normal[all_face],
        albedo=geometry.face_albedo[all_face],
        light=geometry.face_light[all_face],
        is_triangle=is_triangle,
    )
