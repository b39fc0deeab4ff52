"""Energy by level of radiance: 16 levels per octave, exact integers.

The level of a value is given by the upper bits of its float32. Sums of L dA are int64 in units of a fixed fraction of the most that the
room can hold, so that they depend neither on the order of the texels nor on the light: what is subtracted for an old value cancels
to the last bit what was added for it.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.radiometry.half import HALF_MAX

LEVEL_SHIFT: Final = 19
"""Bits of a float32 below its level: exponent and four bits of the mantissa remain."""
LEVELS: Final = 1 << (32 - 1 - LEVEL_SHIFT)


def energy_scale(area: NDArray[np.float32]) -> float:
    """Power of two by which L dA (W/sr) of (N,) texels is multiplied before rounding to an integer.

    The sum over all texels at the largest half float stays below 2^62, and one texel below 2^51, where a double still has room to round.
    """
    total, largest = float(area.sum(dtype=np.float64)), float(area.max(initial=0.0))
    if not total > 0.0:
        return 1.0
    return min(
        2.0 ** (61 - math.ceil(math.log2(HALF_MAX * total))),
        2.0 ** (50 - math.ceil(math.log2(HALF_MAX * largest))),
    )


def level_energy(radiance: NDArray[np.float32], area: NDArray[np.float32], scale: float) -> NDArray[np.int64]:
    """(3, LEVELS) int64 energy of some texels: (n, 3) radiance and (n,) area, `scale` of `energy_scale`."""
    level = radiance.astype(np.float32).view(np.uint32) >> np.uint32(LEVEL_SHIFT)
    amount = np.rint(radiance.astype(np.float64) * (area.astype(np.float64) * scale)[:, None]).astype(
        np.int64
    )
    energy = np.zeros((3, LEVELS), dtype=np.int64)
    for channel in range(3):
        np.add.at(energy[channel], level[:, channel], amount[:, channel])
    return energy
