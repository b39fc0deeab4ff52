import numpy as np
import pytest

from nearfield_server.benchmark.methods.atlas_split import AtlasSplit
from nearfield_server.benchmark.methods.light import AtlasSample, Surroundings
from nearfield_server.benchmark.methods.vpl import VirtualPointLights


def _energy(around: Surroundings, sample: AtlasSample) -> np.ndarray:
    return (sample.radiance.astype(np.float64) * around.texels.area[:, None]).sum(axis=0)


def test_grey_intensities_add_up_to_all_light_whatever_is_sampled(
    around: Surroundings, lamp_sample: AtlasSample
) -> None:
    for lights in (1, 8, 100):
        vals = VirtualPointLights(around, lights, None).extract(lamp_sample).vals
        assert len(vals) == lights
        total = vals["radiant_intensity"].astype(np.float64).sum(axis=0)
        assert total.mean() == pytest.approx(_energy(around, lamp_sample).mean(), rel=1e-5)


def test_many_lights_estimate_every_channel(around: Surroundings, lamp_sample: AtlasSample) -> None:
    vals = VirtualPointLights(around, 4000, None).extract(lamp_sample).vals
    np.testing.assert_allclose(vals["radiant_intensity"].sum(axis=0), _energy(around, lamp_sample), rtol=0.01)


def test_without_a_split_there_are_no_sh(around: Surroundings, lamp_sample: AtlasSample) -> None:
    assert not VirtualPointLights(around, 8, None).extract(lamp_sample).object_sh.any()


def test_with_a_split_lights_and_sh_share_the_light(around: Surroundings, lamp_sample: AtlasSample) -> None:
    light = VirtualPointLights(around, 500, 0.6).extract(lamp_sample)
    threshold, _, total = AtlasSplit(around.texels.area, 0.6, 500).split(lamp_sample.radiance)
    energy = lamp_sample.radiance * around.texels.area[:, None]
    direct = np.where(lamp_sample.radiance >= threshold, energy, 0.0).sum(axis=0)
    assert light.vals["radiant_intensity"].sum(axis=0).mean() == pytest.approx(total, rel=1e-5)
    assert direct.mean() == pytest.approx(total, rel=1e-5)
    assert (direct >= 0.6 * energy.sum(axis=0)).all()
    assert light.object_sh.shape == (2, 9, 3)
    assert (light.object_sh[:, 0] > 0.0).all()


def test_a_black_room_has_no_lights(around: Surroundings, lamp_sample: AtlasSample) -> None:
    black = AtlasSample(frames=(), radiance=np.zeros_like(lamp_sample.radiance))
    for ratio in (None, 0.9):
        light = VirtualPointLights(around, 8, ratio).extract(black)
        assert len(light.vals) == 0
        assert not light.object_sh.any()
