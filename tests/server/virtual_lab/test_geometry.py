from __future__ import annotations

import numpy as np

from nearfield_server.virtual_lab.geometry import build_cells, build_geometry
from nearfield_server.virtual_lab.model import Scene


def test_cells_cover_every_surface_once(tiny_scene: Scene) -> None:
    geometry = build_geometry(tiny_scene, with_objects=True)
    cells = build_cells(tiny_scene, geometry)
    assert len(cells.area) == geometry.num_cells
    corner = geometry.positions[geometry.faces]
    triangle_area = (
        np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
    )
    np.testing.assert_allclose(cells.area.sum(), triangle_area.sum(), rtol=1e-12)
    for index, quad in enumerate(tiny_scene.quads):
        np.testing.assert_allclose(cells.area[cells.face == 2 * index].sum(), quad.area, rtol=1e-12)


def test_cells_respect_their_size(tiny_scene: Scene) -> None:
    cells = build_cells(tiny_scene, build_geometry(tiny_scene, with_objects=False))
    limit = np.array([q.cell_size for q in tiny_scene.quads])[cells.face // 2]
    assert np.all(np.linalg.norm(cells.edge_u, axis=1) <= limit + 1e-9)
    assert np.all(np.linalg.norm(cells.edge_v, axis=1) <= limit + 1e-9)


def test_empty_room_cells_come_first(tiny_scene: Scene) -> None:
    empty, full = (
        build_cells(tiny_scene, build_geometry(tiny_scene, with_objects=flag)) for flag in (False, True)
    )
    count = len(empty.area)
    np.testing.assert_array_equal(full.centre[:count], empty.centre)
    assert full.is_triangle[count:].all()
    assert not empty.is_triangle.any()


def test_cell_lookup_finds_the_cell_of_its_centre(tiny_scene: Scene) -> None:
    geometry = build_geometry(tiny_scene, with_objects=True)
    cells = build_cells(tiny_scene, geometry)
    offset = cells.centre - geometry.face_origin[cells.face]
    column = np.floor(np.sum(offset * geometry.face_u[cells.face], axis=1) * geometry.cells_u[cells.face])
    row = np.floor(np.sum(offset * geometry.face_v[cells.face], axis=1) * geometry.cells_v[cells.face])
    found = geometry.face_cell[cells.face] + row * geometry.cells_u[cells.face] + column
    np.testing.assert_array_equal(found, np.arange(len(cells.area)))


def test_triangles_look_where_their_quads_look(tiny_scene: Scene) -> None:
    geometry = build_geometry(tiny_scene, with_objects=False)
    expected = np.repeat(np.stack([q.normal for q in tiny_scene.quads]), 2, axis=0)
    np.testing.assert_allclose(geometry.face_normal, expected, atol=1e-12)
