import numpy as np

from nearfield_server.benchmark.methods.light import AtlasSample, Surroundings
from nearfield_server.benchmark.methods.webxr import DistantProbe, main_light
from nearfield_server.radiometry.form_factor import val_irradiance
from nearfield_server.radiometry.sh import sh_basis


def test_the_sh_of_one_distant_light_give_it_back() -> None:
    direction = np.array([0.36, 0.48, -0.8])
    irradiance = np.array([3.0, 2.0, 0.5])
    found, strength = main_light(sh_basis(direction)[:, None] * irradiance)
    np.testing.assert_allclose(found, direction, atol=1e-12)
    np.testing.assert_allclose(strength, irradiance, rtol=1e-12)


def test_even_light_has_no_direction() -> None:
    coeffs = np.zeros((9, 3))
    coeffs[0] = 1.0
    assert not main_light(coeffs)[1].any()


def test_all_objects_share_the_probe_and_no_light_counts_twice(
    around: Surroundings, lamp_sample: AtlasSample
) -> None:
    light = DistantProbe(around).extract(lamp_sample)
    (val,) = light.vals
    np.testing.assert_array_equal(light.object_sh[0], light.object_sh[1])
    centre = around.object_centres.mean(axis=0)
    towards = -val["normal"].astype(np.float64)
    irradiance = val_irradiance(
        centre, towards, val["position"], val["normal"], val["radiant_intensity"], float(val["area"])
    )
    # What is left is orthogonal to the light that was taken out.
    np.testing.assert_allclose(sh_basis(towards) @ light.object_sh[0], 0.0, atol=1e-4)
    assert (irradiance > 0.0).all()
    assert towards[1] > 0.0
