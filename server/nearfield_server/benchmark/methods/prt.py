"""All light in the SH at each object's centre, no lights: precomputed radiance transfer alone.

Rohmer et al. 2014, section 6.1 ("PRT only"), and the environment light of Gierlinger et al. 2010, section 3.2. Gierlinger's shadow on
real surfaces is the client's part: the background is multiplied by shadowed over unshadowed irradiance. Differs from the paper,
which prints `(unshadowed - shadowed) / unshadowed`: multiplied into the picture that would blacken what is not shadowed.
"""

from __future__ import annotations

from nearfield_server.benchmark.methods.light import (
    EVERYTHING,
    AtlasSample,
    MethodLight,
    Surroundings,
    no_vals,
    object_sh,
)


class EnvironmentTransfer:
    """SH of the whole environment."""

    def __init__(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings

    def extract(self, sample: AtlasSample) -> MethodLight:
        """Project everything that each object sees."""
        coeffs = object_sh(self._surroundings, sample.radiance, EVERYTHING)
        return MethodLight(vals=no_vals(), object_sh=coeffs)
