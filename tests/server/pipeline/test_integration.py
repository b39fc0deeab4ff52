import numpy as np
import pytest

from nearfield_server.pipeline.blocks import NORMAL_SCALE, BlockPool, cluster_features, make_blocks
from nearfield_server.pipeline.gather import block_maxima
from nearfield_server.pipeline.integration import integrate
from nearfield_server.radiometry.form_factor import polygon_irradiance, val_irradiance
from nearfield_server.reference.box_room import BoxRoom, make_box_room
from nearfield_server.reference.light_stages import integrate_reference


def _case(room: BoxRoom, seed: int, slots: int = 16) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    radiance = (10.0 ** rng.uniform(-3, 3, (room.texels.area.size, 3))).astype(np.float32)
    threshold = np.array([10.0, 100.0, 1.0], dtype=np.float32)
    chosen = rng.choice(room.texels.area.size, slots, replace=False)
    centres = cluster_features(room.texels.position[chosen], room.texels.normal[chosen])
    alive = rng.random(slots) < 0.8
    return radiance, threshold, centres, alive


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_matches_brute_force(room: BoxRoom, pool: BlockPool, seed: int) -> None:
    radiance, threshold, centres, alive = _case(room, seed)
    texels = room.texels
    found = integrate(make_blocks(texels), radiance, block_maxima(radiance), threshold, centres, alive, pool)
    expected = integrate_reference(
        texels.position, texels.normal, texels.area, radiance, threshold, centres, alive
    )
    np.testing.assert_allclose(found.radiant_intensity, expected.radiant_intensity, rtol=1e-12)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-11)
    np.testing.assert_allclose(found.normal, expected.normal, atol=1e-11)
    np.testing.assert_allclose(found.area, expected.area, rtol=1e-9, atol=1e-12)
    for name in ("radiant_intensity", "position", "normal", "area"):
        assert not getattr(found, name)[~alive].any()


@pytest.mark.parametrize("slots", [1, 8, 64])
def test_no_energy_is_lost_or_made(room: BoxRoom, pool: BlockPool, slots: int) -> None:
    radiance, threshold, centres, alive = _case(room, 4, slots)
    alive[0] = True
    found = integrate(
        make_blocks(room.texels), radiance, block_maxima(radiance), threshold, centres, alive, pool
    )
    direct = np.where(radiance >= threshold, radiance, 0.0).astype(np.float64) * room.texels.area[:, None]
    np.testing.assert_allclose(found.radiant_intensity.sum(axis=0), direct.sum(axis=0), rtol=1e-12)


def test_threads_do_not_matter(room: BoxRoom, pool: BlockPool) -> None:
    radiance, threshold, centres, alive = _case(room, 5)
    arguments = (make_blocks(room.texels), radiance, block_maxima(radiance), threshold, centres, alive)
    one, two = integrate(*arguments, BlockPool(1)), integrate(*arguments, pool)
    np.testing.assert_array_equal(one.radiant_intensity, two.radiant_intensity)
    np.testing.assert_array_equal(one.position, two.position)


def test_nothing_alive_gives_nothing(room: BoxRoom, pool: BlockPool) -> None:
    radiance, threshold, centres, _ = _case(room, 6)
    none = np.zeros(centres.shape[0], dtype=bool)
    found = integrate(
        make_blocks(room.texels), radiance, block_maxima(radiance), threshold, centres, none, pool
    )
    assert not found.radiant_intensity.any()
    assert np.isfinite(found.position).all()


@pytest.fixture(scope="module")
def fine_room() -> BoxRoom:
    return make_box_room(atlas_size=512, num_cameras=1, camera_size=8)


def _one_light(room: BoxRoom, pool: BlockPool, half: tuple[float, float]) -> tuple[object, np.ndarray, float]:
    """A rectangle of radiance 1 on the ceiling, as one cluster; with the corners of its texels."""
    position = room.texels.position
    ceiling = room.texels.normal[:, 1] < -0.5
    lit = ceiling & (np.abs(position[:, 0] - 3.0) < half[0]) & (np.abs(position[:, 2] - 2.0) < half[1])
    radiance = np.repeat(lit[:, None], 3, axis=1).astype(np.float32)
    found = integrate(
        make_blocks(room.texels),
        radiance,
        block_maxima(radiance),
        np.full(3, 0.5, dtype=np.float32),
        cluster_features(np.array([[3.0, 3.0, 2.0]]), np.array([[0.0, -1.0, 0.0]])),
        np.ones(1, dtype=bool),
        pool,
    )
    columns, rows = room.resolution
    step = np.array([room.size[0] / columns, room.size[2] / rows]) / 2
    low, high = position[lit][:, [0, 2]].min(axis=0) - step, position[lit][:, [0, 2]].max(axis=0) + step
    corners = np.array(
        [[low[0], 3, low[1]], [high[0], 3, low[1]], [high[0], 3, high[1]], [low[0], 3, high[1]]]
    )
    return found, corners, float(np.prod(high - low))


@pytest.mark.parametrize("half", [(0.3, 0.3), (0.8, 0.05), (0.05, 0.8)])
def test_light_has_the_place_and_second_moment_of_its_rectangle(
    fine_room: BoxRoom, pool: BlockPool, half: tuple[float, float]
) -> None:
    found, corners, area = _one_light(fine_room, pool, half)
    edges = corners.max(axis=0) - corners.min(axis=0)
    np.testing.assert_allclose(found.radiant_intensity[0], area, rtol=1e-5)
    np.testing.assert_allclose(found.position[0], corners.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(found.normal[0], [0, -1, 0], atol=1e-6)
    # A uniform rectangle has <rho^2> = (a^2 + b^2) / 12; texels stand for discs, hence the small allowance.
    assert found.area[0] == pytest.approx(2 * np.pi * (edges**2).sum() / 12, rel=1e-2)


@pytest.mark.parametrize("half", [(0.3, 0.3), (0.8, 0.05)])
def test_disc_of_equal_second_moment_beats_the_plain_area(
    fine_room: BoxRoom, pool: BlockPool, half: tuple[float, float]
) -> None:
    found, corners, area = _one_light(fine_room, pool, half)
    heights = np.array([0.5, 1.0, 1.5, 2.0])
    points = corners.mean(axis=0) - heights[:, None] * [0, 1, 0]
    normals = np.broadcast_to([0.0, 1.0, 0.0], points.shape)
    exact = polygon_irradiance(points, normals, corners, np.ones(3))
    light = (found.position[0], found.normal[0], found.radiant_intensity[0])
    moment = np.abs(val_irradiance(points, normals, *light, found.area[0]) / exact - 1.0)
    plain = np.abs(val_irradiance(points, normals, *light, area) / exact - 1.0)
    assert (moment[2:] < 0.06).all()
    assert moment.max() <= plain.max() + 0.01


def test_centres_of_other_normals_do_not_take_a_texel(pool: BlockPool, room: BoxRoom) -> None:
    # A texel of the ceiling next to a wall: the nearer centre in space lies on the wall, the other on the ceiling.
    texels = room.texels
    texel = int(np.flatnonzero((texels.normal[:, 1] < -0.5) & (texels.position[:, 0] < 0.2))[0])
    radiance = np.zeros((texels.area.size, 3), dtype=np.float32)
    radiance[texel] = 1.0
    position = texels.position[texel].astype(np.float64)
    centres = cluster_features(
        np.stack([position * [0, 1, 1] - [0, 0.05, 0], position + np.array([NORMAL_SCALE, 0, 0])]),
        np.array([[1.0, 0, 0], [0, -1.0, 0]]),
    )
    found = integrate(
        make_blocks(texels),
        radiance,
        block_maxima(radiance),
        np.full(3, 0.5, dtype=np.float32),
        centres,
        np.ones(2, dtype=bool),
        pool,
    )
    assert not found.radiant_intensity[0].any()
    np.testing.assert_allclose(found.area[1], texels.area[texel], rtol=1e-6)
