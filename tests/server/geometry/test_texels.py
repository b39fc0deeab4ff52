from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from structlog.testing import capture_logs

from nearfield_server.geometry.texels import (
    GUTTER_RANGE,
    face_areas,
    face_normals,
    find_gutter,
    rasterise_texels,
)
from nearfield_server.records import RoomMesh, TexelGeometry
from nearfield_server.reference import texels as reference
from nearfield_server.reference.box_room import make_box_room

SIZE = 240


@pytest.fixture(scope="module")
def texels(furnished_room: RoomMesh) -> TexelGeometry:
    return rasterise_texels(furnished_room, SIZE, rasteriser="cpu")


def test_agrees_with_the_reference_except_at_ties(furnished_room: RoomMesh, texels: TexelGeometry) -> None:
    expected = reference.rasterise_texels(furnished_room, SIZE, SIZE)
    face = np.append(texels.face, -1)[texels.lookup]
    differs = face != expected.face
    # The CPU rasteriser snaps to 1/4096 texel: only centres that near to an edge may differ.
    assert expected.edge_distance[differs].max(initial=0.0) < 1 / 4096
    rows, columns = np.divmod(texels.texel_index, SIZE)
    same = ~differs[rows, columns]
    assert same.mean() > 0.95
    np.testing.assert_allclose(texels.position[same], expected.position[rows, columns][same], atol=1e-3 / 24)
    np.testing.assert_allclose(texels.normal[same], expected.normal[rows, columns][same], atol=1e-6)


def test_box_room_matches_its_closed_form() -> None:
    room = make_box_room(atlas_size=128)
    texels = rasterise_texels(room.mesh(), 128, rasteriser="cpu")
    order = np.argsort(texels.texel_index)
    expected_order = np.argsort(room.texels.texel_index)
    np.testing.assert_array_equal(texels.texel_index[order], room.texels.texel_index[expected_order])
    np.testing.assert_allclose(texels.position[order], room.texels.position[expected_order], atol=2e-6)
    np.testing.assert_allclose(texels.normal[order], room.texels.normal[expected_order], atol=1e-7)
    # Shares are per triangle, so a texel's area differs from the wall's mean by the diagonal's texels at most.
    assert texels.area.sum(dtype=np.float64) == pytest.approx(
        room.texels.area.sum(dtype=np.float64), rel=1e-6
    )


def test_area_of_each_triangle_is_shared_out_completely(
    furnished_room: RoomMesh, texels: TexelGeometry
) -> None:
    shared = np.bincount(texels.face, weights=texels.area, minlength=len(furnished_room.faces))
    np.testing.assert_allclose(shared, face_areas(furnished_room), rtol=1e-6)


def test_texels_lie_on_their_triangle(furnished_room: RoomMesh, texels: TexelGeometry) -> None:
    origin = furnished_room.positions[furnished_room.faces[texels.face, 0]]
    normals = face_normals(furnished_room)[texels.face]
    np.testing.assert_allclose(((texels.position - origin) * normals).sum(axis=1), 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(texels.normal, axis=1), 1, atol=1e-6)


def test_lookup_and_index_are_inverse(texels: TexelGeometry) -> None:
    np.testing.assert_array_equal(
        texels.lookup.reshape(-1)[texels.texel_index], np.arange(len(texels.texel_index))
    )
    assert (texels.lookup >= 0).sum() == len(texels.texel_index)
    for name in ("texel_index", "position", "normal", "area", "face", "lookup"):
        assert getattr(texels, name).flags.c_contiguous


def test_order_keeps_atlas_neighbours_together(texels: TexelGeometry) -> None:
    rows, columns = np.divmod(texels.texel_index, SIZE)
    blocks = len(rows) // 64
    spread = np.ptp(rows[: blocks * 64].reshape(-1, 64), axis=1) + np.ptp(
        columns[: blocks * 64].reshape(-1, 64), axis=1
    )
    # Row by row, a block of 64 would span 64 columns; here it spans about four cells of 8 x 8.
    assert np.median(spread) < 32


def test_gutter_repeats_neighbours_within_two_texels(texels: TexelGeometry) -> None:
    covered = texels.lookup.reshape(-1) >= 0
    assert not covered[texels.gutter_texel].any()
    assert len(np.unique(texels.gutter_texel)) == len(texels.gutter_texel)
    gutter = np.stack(np.divmod(texels.gutter_texel, SIZE), axis=1)
    source = np.stack(np.divmod(texels.texel_index[texels.gutter_source], SIZE), axis=1)
    distance = np.abs(gutter - source).max(axis=1)
    assert distance.min() == 1
    assert distance.max() <= GUTTER_RANGE
    # Every uncovered texel that near to a chart is in the list.
    grid = np.argwhere(texels.lookup < 0)
    charts = np.argwhere(texels.lookup >= 0)
    sample = grid[:: max(1, len(grid) // 500)]
    nearest = np.array([np.abs(charts - point).max(axis=1).min() for point in sample])
    listed = np.isin(sample[:, 0] * SIZE + sample[:, 1], texels.gutter_texel)
    np.testing.assert_array_equal(listed, nearest <= GUTTER_RANGE)


def test_gutter_of_one_texel_is_a_square() -> None:
    lookup = np.full((7, 7), -1, dtype=np.int32)
    lookup[3, 3] = 0
    gutter, source = find_gutter(lookup)
    assert len(gutter) == 24
    np.testing.assert_array_equal(source, 0)


def tiny_emitter(room: RoomMesh, uv_centre: tuple[float, float]) -> RoomMesh:
    """The room plus a triangle of a few millimetres that no texel centre falls into."""
    corners = np.array([[1.0, 1.9, 1.0], [1.003, 1.9, 1.0], [1.0, 1.9, 1.004]])
    start = len(room.positions)
    uv = np.array(uv_centre) + np.array([[0.1, 0.1], [0.3, 0.1], [0.1, 0.3]]) / SIZE
    return replace(
        room,
        positions=np.concatenate([room.positions, corners]),
        normals=np.concatenate([room.normals, np.tile([[0.0, -1.0, 0.0]], (3, 1))]),
        uv=np.concatenate([room.uv, uv]),
        faces=np.concatenate([room.faces, [[start, start + 1, start + 2]]]).astype(np.int32),
        face_material=np.append(room.face_material, 0).astype(np.int32),
    )


def test_triangle_without_texel_centre_claims_the_nearest_free_one(furnished_room: RoomMesh) -> None:
    mesh = tiny_emitter(furnished_room, (230 / SIZE, 225 / SIZE))
    texels = rasterise_texels(mesh, SIZE, rasteriser="cpu")
    (claimed,) = np.flatnonzero(texels.face == len(mesh.faces) - 1)
    assert texels.area[claimed] == pytest.approx(0.5 * 0.003 * 0.004)
    np.testing.assert_allclose(texels.position[claimed], mesh.positions[-3:].mean(axis=0), atol=1e-6)
    assert divmod(int(texels.texel_index[claimed]), SIZE) == (225, 230)


def test_triangle_inside_a_chart_gives_its_area_to_the_texel_at_its_place(furnished_room: RoomMesh) -> None:
    inside_ceiling = furnished_room.uv[4:8].mean(axis=0)
    mesh = tiny_emitter(furnished_room, (float(inside_ceiling[0]), float(inside_ceiling[1])))
    texels = rasterise_texels(mesh, SIZE, rasteriser="cpu")
    plain = rasterise_texels(furnished_room, SIZE, rasteriser="cpu")
    (changed,) = np.flatnonzero(texels.area != plain.area)
    assert texels.area[changed] - plain.area[changed] == pytest.approx(0.5 * 0.003 * 0.004, rel=1e-3)
    assert texels.face[changed] // 2 == 1


def test_triangle_that_nothing_can_stand_for_is_counted(furnished_room: RoomMesh) -> None:
    # It faces down, and its place in the atlas is that of the floor, which faces up.
    inside_floor = furnished_room.uv[:4].mean(axis=0)
    mesh = tiny_emitter(furnished_room, (float(inside_floor[0]), float(inside_floor[1])))
    with capture_logs() as logs:
        texels = rasterise_texels(mesh, SIZE, rasteriser="cpu")
    assert logs[0]["lost"] == 1
    assert logs[0]["area"] == pytest.approx(0.5 * 0.003 * 0.004)
    assert texels.face.max() < len(mesh.faces) - 1
