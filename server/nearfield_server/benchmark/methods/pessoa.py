"""Phantom lights by median cut, and image-based light (Pessoa et al. 2012, sections 4.1 to 4.4).

The environment around the first object is cut into regions of equal energy; each becomes a light at `P = K D` (Eq. 15) that casts a soft
shadow. Objects are lit by the irradiance map of their own surroundings, from which undue light is taken where a phantom light is
hidden (Eqs. 17 and 18). Both forms are the corrected ones:

- regions are weighted by the sine of the polar angle (the paper's cosine is right for latitude only);
- Eqs. 17 and 18 as printed subtract `(1 - v max(L.N, 0)) L`, which darkens surfaces that nothing shadows; here it is
  `(1 - v) max(L.N, 0) L`, as in differential rendering. To draw this with lights that add, the SH hold the irradiance map less
  all phantom lights, and the client adds each light where it is seen.

The room hides no phantom light: the distant scene is no part of the shadow maps.
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
    object_sh,
)
from nearfield_server.benchmark.methods.median_cut import LatLongGrid, Region, median_cut
from nearfield_server.radiometry.sh import sh_basis

_ROWS: Final = 64
"""Of the latitude-longitude map; twice as many columns."""


class PhantomLights:
    """Median cut anew for every picture."""

    def __init__(self, surroundings: Surroundings, num_lights: int) -> None:
        """Prepare.

        Args:
            surroundings: static inputs.
            num_lights: a power of two.
        """
        self._surroundings, self._num_lights = surroundings, num_lights
        self._grid = LatLongGrid.make(_ROWS)
        self._pixels = self._grid.cube_pixels(PROBE_RESOLUTION)

    def extract(self, sample: AtlasSample) -> MethodLight:
        """Cut the first object's environment; take its lights out of every object's SH."""
        around = self._surroundings
        texel = around.object_probes[0][self._pixels]
        radiance = np.where(texel[:, None] >= 0, sample.radiance[texel], 0.0).astype(np.float64)
        regions = median_cut(self._grid, radiance, self._num_lights)
        directions = np.array([region.direction for region in regions]).reshape(-1, 3)
        irradiance = np.array([region.irradiance for region in regions]).reshape(-1, 3)
        solid_angle = np.array([region.solid_angle for region in regions])
        coeffs = object_sh(around, sample.radiance, EVERYTHING)
        coeffs = coeffs - (sh_basis(directions).T @ irradiance).astype(np.float32)
        vals = far_lights(
            around.object_centres[0], directions, irradiance, _disc_part(regions, solid_angle), self._reach
        )
        return MethodLight(vals=vals, object_sh=coeffs)

    @property
    def _reach(self) -> float:
        """The constant K of Eq. 15: far behind the walls, as an environment map is."""
        return 2.0 * self._surroundings.room_diagonal


def _disc_part(regions: list[Region], solid_angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solid angle of each light's disc: at most what a disc seen under 45 degrees covers, since regions may be half a sphere."""
    limit = np.full(len(regions), 2.0 * np.pi * (1.0 - np.sqrt(0.5)))
    return np.asarray(np.minimum(solid_angle, limit))
