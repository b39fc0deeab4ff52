"""Virtual point lights: instant radiosity from the radiance atlas (Rohmer et al. 2014, section 6.1, Eq. 14)."""

from __future__ import annotations

import numpy as np

from nearfield_server.benchmark.methods.atlas_split import AtlasSplit
from nearfield_server.benchmark.methods.light import (
    AtlasSample,
    MethodLight,
    Surroundings,
    make_vals,
    no_vals,
    object_sh,
)


class VirtualPointLights:
    """I_VPL = I_s / (N p_s), with p the grey radiant intensity's share (Eq. 14).

    Without a split the lights carry all light and there are no SH; with one they carry what is direct. A light has the area of its
    texel, a few square centimetres or less: practically the point form of Eq. 6.
    """

    def __init__(self, surroundings: Surroundings, num_lights: int, ratio: float | None) -> None:
        """Prepare.

        Args:
            surroundings: static inputs.
            num_lights: N.
            ratio: share of the light that becomes direct, None = no split.
        """
        self._surroundings = surroundings
        self._atlas = AtlasSplit(surroundings.texels.area, ratio, num_lights)

    def extract(self, sample: AtlasSample) -> MethodLight:
        """Sample, and weigh each sample by its density."""
        texels, radiance = self._surroundings.texels, sample.radiance
        threshold, chosen, total = self._atlas.split(radiance)
        below = self._atlas.indirect_threshold(threshold)
        count = len(self._surroundings.object_probes)
        coeffs = (
            np.zeros((count, 9, 3), np.float32)
            if below is None
            else object_sh(self._surroundings, radiance, below)
        )
        if not len(chosen):
            return MethodLight(vals=no_vals(), object_sh=coeffs)
        own = radiance[chosen].astype(np.float64)
        own = np.where(own >= threshold, own, 0.0)
        # I_s / p_s = L dA / (grey L dA / total): the texel's area cancels.
        intensity = own / own.mean(axis=1, keepdims=True) * (total / len(chosen))
        vals = make_vals(texels.position[chosen], texels.normal[chosen], intensity, texels.area[chosen])
        return MethodLight(vals=vals, object_sh=coeffs)
