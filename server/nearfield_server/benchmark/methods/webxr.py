"""The light of WebXR Lighting Estimation: SH of one distant probe, one directional light, a small cube map.

Ideal conditions: the probe measures the true light of the room, at its middle, where a tablet has to guess it. Diffuse objects need only
the SH and the directional light; the cube map (for mirror-like materials) is neither drawn nor counted in the bytes. Objects are
lit without any occlusion; the directional light casts one shadow; the room itself hides nothing, since such a client has no model of it.
The directional light is what the SH say it is: main direction of the grey linear band, strength by least squares over all nine
coefficients (Sloan 2008, "Stupid spherical harmonics tricks"); the SH keep the rest, so that no light counts twice.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.benchmark.methods.directional import far_lights
from nearfield_server.benchmark.methods.light import (
    EVERYTHING,
    PROBE_RESOLUTION,
    AtlasSample,
    MethodLight,
    Surroundings,
    no_vals,
)
from nearfield_server.pipeline.sh_projection import project_indirect
from nearfield_server.radiometry.sh import sh_basis

_DISTANCE: Final = 20.0
"""Metres: across an object of 0.3 m the light's direction turns by less than one degree."""
_SOLID_ANGLE: Final = 6e-4
"""Steradians, a disc of 1.6 degrees: a hard shadow without stairs."""


class DistantProbe:
    """One probe in the middle of the room for all objects."""

    def __init__(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings

    def extract(self, sample: AtlasSample) -> MethodLight:
        """SH at the room's centre, less the directional light."""
        around = self._surroundings
        coeffs = project_indirect(around.room_probe, PROBE_RESOLUTION, sample.radiance, EVERYTHING)
        direction, irradiance = main_light(coeffs)
        count = len(around.object_probes)
        if not irradiance.any():
            return MethodLight(vals=no_vals(), object_sh=_for_all(coeffs, count))
        rest = coeffs - sh_basis(direction)[:, None] * irradiance
        centre = around.object_centres.mean(axis=0)
        vals = far_lights(centre, direction[None], irradiance[None], np.array([_SOLID_ANGLE]), _DISTANCE)
        return MethodLight(vals=vals, object_sh=_for_all(rest, count))


def main_light(coeffs: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Direction (3,) towards the main light and its irradiance (3,), from sh_coeffs (9, 3); zero where there is no direction."""
    linear = coeffs[[3, 1, 2]].mean(axis=1)
    length = float(np.linalg.norm(linear))
    if length == 0.0:
        return np.array([0.0, 1.0, 0.0]), np.zeros(3)
    direction = linear / length
    basis = sh_basis(direction)
    return direction, np.maximum(basis @ coeffs / (basis @ basis), 0.0)


def _for_all(coeffs: NDArray[np.float64], count: int) -> NDArray[np.float32]:
    return np.repeat(coeffs[None].astype(np.float32), count, axis=0)
