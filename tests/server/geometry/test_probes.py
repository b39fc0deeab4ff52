from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.geometry.probes import ProbeRays
from nearfield_server.geometry.texels import face_normals, rasterise_texels
from nearfield_server.radiometry.cube import cube_directions, cube_solid_angles
from nearfield_server.records import RoomMesh, TexelGeometry
from nearfield_server.reference.box_room import make_box_room
from nearfield_server.reference.visibility import first_face


@pytest.fixture(scope="module")
def texels(furnished_room: RoomMesh) -> TexelGeometry:
    return rasterise_texels(furnished_room, 240, rasteriser="cpu")


def test_box_room_agrees_with_its_closed_form() -> None:
    room = make_box_room(atlas_size=128)
    mesh = room.mesh()
    texels = rasterise_texels(mesh, 128, rasteriser="cpu")
    centre = np.array([2.137, 1.211, 1.683])
    found = texels.texel_index[ProbeRays(mesh, texels).trace(centre, 16)]
    expected = room.texels.texel_index[room.trace(centre, 16)]
    rows, columns = np.divmod(found, 128)
    expected_rows, expected_columns = np.divmod(expected, 128)
    distance = np.maximum(np.abs(rows - expected_rows), np.abs(columns - expected_columns))
    # Hits on the border between two texels may round either way.
    assert (distance == 0).mean() > 0.99
    assert distance.max() <= 1


def test_hits_the_triangle_of_brute_force(furnished_room: RoomMesh, texels: TexelGeometry) -> None:
    centre = np.array([1.413, 1.127, 1.571])
    directions = cube_directions(16)
    face, distance = first_face(furnished_room, np.broadcast_to(centre, directions.shape), directions)
    front = (face_normals(furnished_room)[face] * directions).sum(axis=1) < 0
    found = ProbeRays(furnished_room, texels).trace(centre, 16)
    np.testing.assert_array_equal(found >= 0, (face >= 0) & front)
    hit = found >= 0
    assert (texels.face[found[hit]] == face[hit]).mean() > 0.995
    points = centre + distance[hit, None] * directions[hit]
    # At most a texel and a half away: 24.3 texels per metre.
    assert np.linalg.norm(texels.position[found[hit]] - points, axis=1).max() < 1.5 * np.sqrt(2) / 24.3


def test_uniform_room_gives_four_pi(furnished_room: RoomMesh, texels: TexelGeometry) -> None:
    found = ProbeRays(furnished_room, texels).trace(np.array([0.6, 1.0, 0.6]), 8)
    assert (found >= 0).all()
    assert cube_solid_angles(8)[found >= 0].sum() == pytest.approx(4 * np.pi)


def test_outside_and_back_faces_are_dark(furnished_room: RoomMesh, texels: TexelGeometry) -> None:
    found = ProbeRays(furnished_room, texels).trace(np.array([-5.0, 1.0, 1.5]), 8)
    assert (found == -1).all()


def test_triangles_without_texel_show_their_neighbours() -> None:
    # 12,288 triangles in an atlas of 96 x 96 = 9,216 texels: thousands own none.
    room = make_box_room(atlas_size=96).mesh()
    positions, uv, faces = room.positions, room.uv, room.faces
    for _ in range(5):
        corners = np.stack([np.arange(len(faces) * 3).reshape(-1, 3)], axis=0)[0]
        positions, uv = positions[faces].reshape(-1, 3), uv[faces].reshape(-1, 2)
        middle = [(positions[corners[:, i]] + positions[corners[:, (i + 1) % 3]]) / 2 for i in range(3)]
        middle_uv = [(uv[corners[:, i]] + uv[corners[:, (i + 1) % 3]]) / 2 for i in range(3)]
        start = len(positions)
        count = len(faces)
        ab, bc, ca = (start + i * count + np.arange(count) for i in range(3))
        a, b, c = corners.T
        positions, uv = np.concatenate([positions, *middle]), np.concatenate([uv, *middle_uv])
        faces = np.concatenate(
            [np.stack(f, axis=1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    crosses = np.cross(
        positions[faces[:, 1]] - positions[faces[:, 0]], positions[faces[:, 2]] - positions[faces[:, 0]]
    )
    normals = np.zeros_like(positions)
    normals[faces] = (crosses / np.linalg.norm(crosses, axis=1, keepdims=True))[:, None]
    mesh = RoomMesh(
        positions=positions,
        normals=normals,
        uv=uv,
        faces=faces.astype(np.int32),
        face_material=np.zeros(len(faces), dtype=np.int32),
        materials=("wall",),
        material_albedo=np.full((1, 3), 0.5),
        uv_source="file",
        content_hash="fine box",
    )
    texels = rasterise_texels(mesh, 96, rasteriser="cpu")
    assert len(faces) - len(np.unique(texels.face)) > 3000
    # No area is lost, and no direction is dark.
    assert texels.area.sum(dtype=np.float64) == pytest.approx(2 * (6 * 3 + 3 * 4 + 6 * 4), rel=1e-6)
    assert (ProbeRays(mesh, texels).trace(np.array([2.137, 1.211, 1.683]), 16) >= 0).all()


def test_sees_what_brute_force_sees(furnished_room: RoomMesh, texels: TexelGeometry) -> None:
    centre = np.array([1.413, 1.127, 1.571])
    targets = np.random.default_rng(3).uniform((0.1, 0.1, 0.1), (2.9, 2.3, 2.9), (400, 3))
    _, distance = first_face(furnished_room, np.broadcast_to(centre, targets.shape), targets - centre)
    assert 20 < np.count_nonzero(distance < 1.0) < 380
    np.testing.assert_array_equal(ProbeRays(furnished_room, texels).sees(centre, targets), distance >= 1.0)


def test_a_point_on_a_surface_is_seen(furnished_room: RoomMesh, texels: TexelGeometry) -> None:
    centre = np.array([0.6, 1.0, 0.6])
    directions = cube_directions(4)
    face, distance = first_face(furnished_room, np.broadcast_to(centre, directions.shape), directions)
    points = centre + distance[face >= 0, None] * directions[face >= 0]
    assert ProbeRays(furnished_room, texels).sees(centre, points).all()
