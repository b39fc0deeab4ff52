"""Split by a fixed share of the light, and importance sampling, as the papers print them."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.pipeline.blocks import BLOCK, BlockPool
from nearfield_server.pipeline.sampling import sample_direct_texels, stratified_pattern
from nearfield_server.pipeline.split import ratio_threshold

PAPER_RATIO: Final = 0.9
"""Share of the light that becomes direct: Rohmer et al. 2014, section 4.2, use 0.75 to 0.98."""
_SEED: Final = 1
_NOTHING: Final = np.zeros(3, dtype=np.float32)


class AtlasSplit:
    """Threshold and samples of the direct atlas.

    Differs from the paper in the baselines' favour: the random numbers are stratified and the same for every picture, so that only
    the pictures' noise moves the samples.
    """

    def __init__(self, area: NDArray[np.float32], ratio: float | None, num_samples: int) -> None:
        """Prepare.

        Args:
            area: (N,) of the texels, m^2.
            ratio: share of the light that becomes direct; None for all of it, without a split.
            num_samples: S.
        """
        self._area, self._ratio = area, ratio
        self._pattern = stratified_pattern(num_samples, _SEED)
        self._pool = BlockPool()
        self._starts = np.arange(0, len(area), BLOCK)

    def split(self, radiance: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.int64], float]:
        """Threshold, sampled texels and the grey sum of direct L dA.

        Rohmer et al. 2014, section 4.2, Eqs. 1 to 4, and section 4.3: density proportional to grey radiant intensity.

        Args:
            radiance: (N, 3).

        Returns:
            (3,) radiance from which a channel is direct, (S,) or (0,) positions in texel order, W/sr.
        """
        block_max = np.maximum.reduceat(radiance, self._starts, axis=0)
        threshold = _NOTHING
        if self._ratio is not None:
            threshold = ratio_threshold(radiance, self._area, block_max, self._ratio, self._pool)
        samples, total = sample_direct_texels(
            radiance, self._area, threshold, block_max, self._pattern, self._pool
        )
        return threshold, samples, total

    def indirect_threshold(self, threshold: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """What the SH leave out; None where there is no split and hence no SH."""
        return None if self._ratio is None else threshold
