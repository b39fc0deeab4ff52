import numpy as np

from nearfield_server.benchmark.methods.directional import far_lights
from nearfield_server.radiometry.form_factor import val_irradiance


def test_a_surface_at_the_centre_gets_the_irradiance_asked_for() -> None:
    centre = np.array([1.0, 2.0, 3.0])
    directions = np.array([[0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
    irradiance = np.array([[1.0, 2.0, 3.0], [0.5, 0.25, 0.125]])
    vals = far_lights(centre, directions, irradiance, np.array([0.5, 1.5]), 7.0)
    for val, direction, expected in zip(vals, directions, irradiance, strict=True):
        found = val_irradiance(
            centre, direction, val["position"], val["normal"], val["radiant_intensity"], float(val["area"])
        )
        np.testing.assert_allclose(found, expected, rtol=1e-5)
