"""Lights of an environment map, which know a direction but no place: drawn as small far discs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nearfield_server.benchmark.methods.light import make_vals


def far_lights(
    centre: NDArray[np.float64],
    directions: NDArray[np.float64],
    irradiance: NDArray[np.float64],
    solid_angle: NDArray[np.float64],
    distance: float,
) -> NDArray[np.void]:
    """Discs at `centre + distance * direction` that face the centre.

    Args:
        centre: (3,) world.
        directions: (M, 3) unit, towards the lights.
        irradiance: (M, 3) of a surface at the centre that faces the light, W/m^2.
        solid_angle: (M,) that each disc covers, sr.
        distance: metres.
    """
    area = solid_angle * distance**2
    intensity = irradiance * (distance**2 + area / np.pi)[:, None]
    return make_vals(centre + distance * directions, -directions, intensity, area)
