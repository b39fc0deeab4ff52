"""The oracles themselves, against closed forms."""

import numpy as np
import pytest

from nearfield_server.radiometry.form_factor import disc_irradiance_on_axis, polygon_irradiance
from nearfield_server.reference.box_room import BoxRoom, make_box_room
from nearfield_server.reference.direct_light import direct_sum_irradiance, vpl_irradiance
from nearfield_server.reference.light_stages import ratio_threshold_reference


@pytest.fixture(scope="module")
def room() -> BoxRoom:
    return make_box_room(atlas_size=256, num_cameras=2, camera_size=64)


def test_texels_cover_the_box(room: BoxRoom) -> None:
    assert room.texels.area.sum(dtype=np.float64) == pytest.approx(108.0, rel=1e-6)
    assert (room.face_of(room.texels.position.astype(np.float64)) == room.texels.face // 2).all()
    found = room.texels.lookup.reshape(-1)[room.texels.texel_index]
    np.testing.assert_array_equal(found, np.arange(room.texels.area.size))


def test_texel_centres_find_themselves(room: BoxRoom) -> None:
    position = room.texels.position.astype(np.float64)
    np.testing.assert_array_equal(room.texel_at(position), np.arange(position.shape[0]))


def test_mesh_faces_look_inwards_and_match_the_texels(room: BoxRoom) -> None:
    mesh = room.mesh()
    corners = mesh.positions[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert 0.5 * np.linalg.norm(cross, axis=1).sum() == pytest.approx(108.0)
    assert (np.einsum("fi,fi->f", cross, mesh.normals[mesh.faces[:, 0]]) > 0.0).all()
    # The atlas position of a texel, interpolated from its triangle's UVs, is its world position.
    texel = np.arange(0, room.texels.area.size, 997)
    row, column = np.divmod(room.texels.texel_index[texel], room.texels.width)
    uv = (np.stack([column, row], axis=1) + 0.5) / room.atlas_size
    first = mesh.faces[room.texels.face[texel]]
    edges = (mesh.uv[first[:, 1:]] - mesh.uv[first[:, :1]]).transpose(0, 2, 1)
    weights = np.linalg.solve(edges, (uv - mesh.uv[first[:, 0]])[..., None])[..., 0]
    base = mesh.positions[first[:, 0]]
    world = base + np.einsum("nk,nki->ni", weights, mesh.positions[first[:, 1:]] - base[:, None])
    np.testing.assert_allclose(world, room.texels.position[texel], atol=1e-5)


def test_gather_weights_sum_to_one(room: BoxRoom) -> None:
    sums = np.add.reduceat(room.table.weight, room.table.pair_start[:-1][np.diff(room.table.pair_start) > 0])
    np.testing.assert_allclose(sums, 1.0, rtol=1e-6)


def test_direct_sum_is_the_exact_form_factor_of_a_rectangle(room: BoxRoom) -> None:
    ceiling = room.texels.normal[:, 1] < -0.5
    lit = (
        ceiling
        & (np.abs(room.texels.position[:, 0] - 3) < 0.5)
        & (np.abs(room.texels.position[:, 2] - 2) < 0.4)
    )
    radiance = np.repeat(lit[:, None] * 5.0, 3, axis=1)
    columns, rows = room.resolution
    step = np.array([6.0 / columns, 4.0 / rows]) / 2
    low = room.texels.position[lit][:, [0, 2]].min(axis=0) - step
    high = room.texels.position[lit][:, [0, 2]].max(axis=0) + step
    corners = np.array(
        [[low[0], 3, low[1]], [high[0], 3, low[1]], [high[0], 3, high[1]], [low[0], 3, high[1]]]
    )
    points = np.array([[3.0, 0.5, 2.0], [1.0, 0.0, 1.0], [4.5, 2.0, 3.0]])
    normals = np.array([[0.0, 1.0, 0.0], [0.0, 0.8, 0.6], [-0.28, 0.96, 0.0]])
    exact = polygon_irradiance(points, normals, corners, np.full(3, 5.0))
    np.testing.assert_allclose(
        direct_sum_irradiance(room.texels, radiance, points, normals), exact, rtol=2e-3
    )


def test_inside_a_white_box_irradiance_is_pi(room: BoxRoom) -> None:
    radiance = np.ones((room.texels.area.size, 3))
    points = np.array([[3.0, 1.5, 2.0], [1.0, 0.7, 3.0]])
    normals = np.array([[0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
    np.testing.assert_allclose(
        direct_sum_irradiance(room.texels, radiance, points, normals), np.pi, rtol=5e-3
    )


def test_point_lights_agree_on_average(room: BoxRoom) -> None:
    rng = np.random.default_rng(1)
    radiance = np.repeat(rng.exponential(size=(room.texels.area.size, 1)), 3, axis=1)
    grey = (radiance * room.texels.area[:, None]).mean(axis=1)
    chosen = rng.choice(grey.size, 20000, p=grey / grey.sum())
    points, normals = np.array([[3.0, 1.5, 2.0]]), np.array([[0.0, 1.0, 0.0]])
    expected = direct_sum_irradiance(room.texels, radiance, points, normals)
    np.testing.assert_allclose(
        vpl_irradiance(room.texels, radiance, chosen, points, normals), expected, rtol=0.05
    )


def test_disc_on_axis_tends_to_both_limits() -> None:
    assert disc_irradiance_on_axis(0.0, 0.3, 2.0) == pytest.approx(2.0 * np.pi)
    assert disc_irradiance_on_axis(1e4, 0.3, 2.0) == pytest.approx(2.0 * np.pi * 0.09 / 1e8, rel=1e-6)


def test_threshold_by_hand() -> None:
    radiance = np.array([[4.0, 0.0, 1.0], [3.0, 0.0, 1.0], [2.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    area = np.ones(4, dtype=np.float32)
    np.testing.assert_array_equal(ratio_threshold_reference(radiance, area, 0.5), [3.0, np.inf, 1.0])
    np.testing.assert_array_equal(ratio_threshold_reference(radiance, area, 0.4), [4.0, np.inf, 1.0])
    np.testing.assert_array_equal(ratio_threshold_reference(radiance, area, 1.0), [1.0, np.inf, 1.0])
