import numpy as np

from nearfield_server.benchmark.methods.light import EVERYTHING, AtlasSample, Surroundings, object_sh
from nearfield_server.benchmark.methods.pessoa import PhantomLights
from nearfield_server.radiometry.form_factor import val_irradiance
from nearfield_server.radiometry.sh import sh_basis


def test_where_nothing_is_hidden_lights_and_sh_are_the_irradiance_map(
    around: Surroundings, lamp_sample: AtlasSample
) -> None:
    light = PhantomLights(around, 16).extract(lamp_sample)
    assert len(light.vals) == 16
    together = light.object_sh[0].astype(np.float64)
    for val in light.vals:
        towards = -val["normal"].astype(np.float64)
        irradiance = val_irradiance(
            around.object_centres[0],
            towards,
            val["position"],
            val["normal"],
            val["radiant_intensity"],
            float(val["area"]),
        )
        together += sh_basis(towards)[:, None] * irradiance
    expected = object_sh(around, lamp_sample.radiance, EVERYTHING)[0]
    np.testing.assert_allclose(together, expected, atol=1e-3 * np.abs(expected).max())


def test_a_black_room_has_no_lights(around: Surroundings, lamp_sample: AtlasSample) -> None:
    light = PhantomLights(around, 8).extract(
        AtlasSample(frames=(), radiance=np.zeros_like(lamp_sample.radiance))
    )
    assert len(light.vals) == 0
    assert not light.object_sh.any()
