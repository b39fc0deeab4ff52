import numpy as np
import pytest

from nearfield_server.benchmark.methods.clustered import ClusteredLights, lloyd
from nearfield_server.benchmark.methods.light import AtlasSample, Surroundings


@pytest.mark.parametrize("lights", [1, 8, 64])
def test_lights_hold_all_light_and_all_area(
    around: Surroundings, lamp_sample: AtlasSample, lights: int
) -> None:
    vals = ClusteredLights(around, lights, None).extract(lamp_sample).vals
    area = around.texels.area.astype(np.float64)
    np.testing.assert_allclose(
        vals["radiant_intensity"].astype(np.float64).sum(axis=0),
        (lamp_sample.radiance * area[:, None]).sum(axis=0),
        rtol=1e-5,
    )
    lit = lamp_sample.radiance.any(axis=1)
    assert vals["area"].astype(np.float64).sum() == pytest.approx(area[lit].sum(), rel=1e-5)
    np.testing.assert_allclose(np.linalg.norm(vals["normal"], axis=1), 1.0, rtol=1e-5)


def test_one_lamp_becomes_one_light_at_its_place(around: Surroundings, lamp_sample: AtlasSample) -> None:
    lamp = np.where(lamp_sample.radiance > 20.0, lamp_sample.radiance, 0.0).astype(np.float32)
    (val,) = ClusteredLights(around, 1, None).extract(AtlasSample(frames=(), radiance=lamp)).vals
    own = lamp.any(axis=1)
    np.testing.assert_allclose(val["position"], around.texels.position[own].mean(axis=0), atol=1e-3)
    np.testing.assert_allclose(val["normal"], around.texels.normal[own][0], atol=1e-5)


def test_equal_pictures_give_equal_lights(around: Surroundings, lamp_sample: AtlasSample) -> None:
    method = ClusteredLights(around, 16, 0.9)
    first, second = method.extract(lamp_sample), method.extract(lamp_sample)
    assert first.vals.tobytes() == second.vals.tobytes()
    np.testing.assert_array_equal(first.object_sh, second.object_sh)


def test_lloyd_finds_the_means_of_groups_far_apart() -> None:
    rng = np.random.default_rng(3)
    means = np.array([[0.0] * 6, [10.0] * 6, [-10.0, 10.0, 0.0, 0.0, 0.0, 0.0]])
    points = np.concatenate([mean + rng.normal(0.0, 0.1, (50, 6)) for mean in means])
    found = lloyd(points, points[[3, 60, 120]], 20)
    expected = np.array([points[50 * k : 50 * (k + 1)].mean(axis=0) for k in range(3)])
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_centre_without_points_stays() -> None:
    found = lloyd(np.zeros((4, 6)), np.array([[0.0] * 6, [5.0] * 6]), 3)
    np.testing.assert_array_equal(found, [[0.0] * 6, [5.0] * 6])
