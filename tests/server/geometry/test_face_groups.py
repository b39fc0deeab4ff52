from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from nearfield_server.geometry.face_groups import face_groups
from nearfield_server.records import RoomMesh


def soup(positions: np.ndarray, faces: np.ndarray) -> RoomMesh:
    return RoomMesh(
        positions=positions,
        normals=np.zeros_like(positions),
        uv=np.zeros((len(positions), 2)),
        faces=faces.astype(np.int32),
        face_material=np.zeros(len(faces), dtype=np.int32),
        materials=("m",),
        material_albedo=np.full((1, 3), 0.5),
        uv_source="file",
        content_hash="",
    )


def quad_groups(mesh: RoomMesh) -> np.ndarray:
    """Surface of each quad of the furnished room; both triangles of a quad agree."""
    groups = face_groups(mesh).reshape(-1, 2)
    np.testing.assert_array_equal(groups[:, 0], groups[:, 1])
    return groups[:, 0]


def test_ceiling_pieces_join_over_t_junctions_and_the_flush_lamp_stays_apart(
    furnished_room: RoomMesh,
) -> None:
    groups = quad_groups(furnished_room)
    ceiling, lamp = groups[[1, 2, 4, 5]], groups[3]
    assert len(set(ceiling)) == 1
    assert lamp not in ceiling
    # Floor, ceiling, lamp, four walls, two sides of the table, two sides of the hanging lamp.
    assert len(set(groups)) == 11


def test_group_does_not_depend_on_shared_vertices() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=2)
    split = soup(
        sphere.vertices[sphere.faces].reshape(-1, 3), np.arange(3 * len(sphere.faces)).reshape(-1, 3)
    )
    assert set(face_groups(soup(sphere.vertices, sphere.faces))) == {0}
    assert set(face_groups(split)) == {0}


def test_box_has_six_surfaces_and_material_separates() -> None:
    box = trimesh.creation.box()
    mesh = soup(np.asarray(box.vertices), np.asarray(box.faces))
    assert len(set(face_groups(mesh))) == 6
    coloured = replace(mesh, face_material=np.arange(12, dtype=np.int32), materials=tuple("abcdefghijkl"))
    assert len(set(face_groups(coloured))) == 12


def test_two_tables_of_one_height_are_two_surfaces() -> None:
    top = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], dtype=float)
    mesh = soup(np.concatenate([top, top + np.array([3.0, 0.0, 0.0])]), np.arange(6).reshape(2, 3))
    assert len(set(face_groups(mesh))) == 2
