"""The ray tracer that the pipeline is given."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class ProbeTracer(Protocol):
    """Finds the texel behind every pixel of a cube; `geometry.probes.ProbeRays` is one."""

    def trace(self, centre_world: NDArray[np.float64], resolution: int = 32) -> NDArray[np.int32]:
        """(6 R R,) position in texel order or -1, pixels in the order of `radiometry.cube.cube_directions`."""
