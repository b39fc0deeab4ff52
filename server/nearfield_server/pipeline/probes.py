"""The ray tracer that the pipeline is given."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class ProbeTracer(Protocol):
    """Finds the texel behind every pixel of a cube; `geometry.probes.ProbeRays` is one."""

    def trace(self, centre_world: NDArray[np.float64], resolution: int = 32) -> NDArray[np.int32]:
        """(6 R R,) position in texel order or -1, pixels in the order of `radiometry.cube.cube_directions`."""


class SightTracer(ProbeTracer, Protocol):
    """A probe tracer that also answers for single points."""

    def sees(
        self, origin_world: NDArray[np.float64], targets_world: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """(n,) whether nothing of the room lies between the origin (3,) and each target (n, 3)."""
