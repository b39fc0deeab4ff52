"""The texels of hidden lamps from update to update: estimated anew only when what betrays them has changed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.pipeline.blocks import BLOCK
from nearfield_server.pipeline.gather import Atlas
from nearfield_server.pipeline.hidden_light import HiddenLight, estimate_hidden_radiance
from nearfield_server.pipeline.levels import LEVELS, level_energy


class HiddenTexels:
    """Keeps the radiance of hidden surfaces in the atlas true.

    The estimate is a function of the radiance in some blocks, so that leaving it out while they are as they were changes nothing.
    """

    def __init__(self, hidden: HiddenLight, num_blocks: int) -> None:
        self._hidden = hidden
        self._is_settled = False
        self.input_blocks = np.zeros(num_blocks, dtype=np.bool_)
        self.input_blocks[hidden.receiver // BLOCK] = True
        self.input_blocks[hidden.ray_texel // BLOCK] = True
        self.energy = np.zeros((3, LEVELS), dtype=np.int64)
        """(3, LEVELS) of the hidden texels, in the units of the atlas."""

    def update(self, atlas: Atlas, changed: NDArray[np.bool_]) -> None:
        """Estimate and write the hidden radiance if need be.

        Args:
            atlas: freshly gathered.
            changed: (B,) blocks with new radiance; those of changed hidden texels are added.
        """
        if self._is_settled and not (changed & self.input_blocks).any():
            return
        self._is_settled = False
        values = estimate_hidden_radiance(self._hidden, atlas.radiance)
        texels = self._hidden.texels
        touched = write_hidden_radiance(texels, self._hidden.group, values, atlas.radiance, atlas.block_max)
        if touched.any():
            self.energy = level_energy(atlas.radiance[texels], atlas.area[texels], atlas.energy_scale)
        # What one hidden lamp throws on the receivers of another makes its light an input of the next estimate.
        self._is_settled = not (touched & self.input_blocks).any()
        changed |= touched


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _write(texels: Any, group: Any, values: Any, radiance: Any, touched: Any) -> None:
    for k in range(texels.shape[0]):
        for channel in range(3):
            value = np.float32(values[group[k], channel])
            if radiance[texels[k], channel] != value:
                radiance[texels[k], channel] = value
                touched[texels[k] // BLOCK] = True


def write_hidden_radiance(
    texels: NDArray[np.int32],
    group: NDArray[np.int32],
    values: NDArray[np.float64],
    radiance: NDArray[np.float32],
    block_max: NDArray[np.float32],
) -> NDArray[np.bool_]:
    """Set hidden texels to the radiance of their surface and keep the block maxima true.

    Args:
        texels: (H,) positions in texel order.
        group: (H,) surface of each.
        values: (G, 3) radiance of the surfaces.
        radiance: (N, 3), updated.
        block_max: (B, 3), updated.

    Returns:
        (B,) bool, blocks that changed.
    """
    touched = np.zeros(block_max.shape[0], dtype=np.bool_)
    _write(texels, group, values, radiance, touched)
    for block in np.flatnonzero(touched):
        block_max[block] = radiance[block * BLOCK : (block + 1) * BLOCK].max(axis=0)
    return touched
