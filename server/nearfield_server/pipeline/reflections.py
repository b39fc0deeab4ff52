"""Tells a class of bright texels that only reflect from one that shines.

The spot of a desk lamp on the table of a dark room stands out of the histogram like a source, but it is reflected light:
pressed into a few virtual area lights it would be hidden by the very object that stands in it. A reflecting surface cannot
shine brighter than what arrives there allows: `L <= albedo / pi * E`. So the irradiance of the brighter classes is summed
over samples of the class, without visibility (an upper bound of what they can give), and compared with what it shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from nearfield_server.records import RoomMesh, TexelGeometry

REFLECTED_SHARE: Final = 1.0 / 3.0
"""Share of a class's light, explained by the brighter classes directly, from which on it counts as reflected. In a closed
room of mean reflectance p further reflections multiply the direct irradiance by up to 1 / (1 - p): 3 at p = 2/3, a bright room."""
_SOURCES: Final = 128
_RECEIVERS: Final = 256


class TexelPicker(Protocol):
    """What a device of the light stages offers to look at single texels."""

    def pick(self, threshold: NDArray[np.float32]) -> NDArray[np.int64]:
        """(S,) texels with density proportional to the L dA of what is at or above the threshold; (0,) where nothing is."""

    def radiance_of(self, texel: NDArray[np.int64], channel: int) -> NDArray[np.float64]:
        """Radiance (n,) of texels in one channel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reflectors:
    """Static data of the test: the texels' places and albedos.

    Attributes:
        position, normal: (N, 3). albedo: (N, 3).
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    albedo: NDArray[np.float32]


def make_reflectors(mesh: RoomMesh, texels: TexelGeometry) -> Reflectors:
    """Look up the albedo of every texel."""
    albedo = mesh.material_albedo[mesh.face_material[texels.face]].astype(np.float32)
    return Reflectors(position=texels.position, normal=texels.normal, albedo=albedo)


def reflected_share(
    reflectors: Reflectors,
    picker: TexelPicker,
    channel: int,
    upper: float,
    lower: float,
    energy_above: float,
    area_above: float,
) -> float:
    """Share of the light of the texels between two cuts that those above the upper cut explain as reflected once.

    Args:
        reflectors: static data.
        picker: device.
        channel: 0 to 2.
        upper: radiance of the upper cut.
        lower: radiance of the lower one.
        energy_above: sum L dA at and above the upper cut, W/sr.
        area_above: area of the same texels, m^2.

    Returns:
        Ratio of sum (albedo / pi) E dA to sum L dA over the class, an estimate from samples; it can exceed 1 because
        nothing is hidden.
    """
    sources = _thin(picker.pick(_only(channel, upper)), _SOURCES)
    below = picker.pick(_only(channel, lower))
    value = picker.radiance_of(below, channel)
    in_class = np.flatnonzero(value < upper)
    members = _thin(in_class, _RECEIVERS)
    if not sources.size or not members.size:
        return 0.0
    irradiance = _irradiance(reflectors, sources, below[members], energy_above, area_above)
    albedo = reflectors.albedo[below[members], channel].astype(np.float64)
    # Texels were picked in proportion to L dA: the mean of the ratios is the ratio of the sums.
    return float(np.mean(albedo / np.pi * irradiance / value[members]))


def _irradiance(
    reflectors: Reflectors,
    sources: NDArray[np.int64],
    receivers: NDArray[np.int64],
    energy: float,
    area: float,
) -> NDArray[np.float64]:
    """(R,) irradiance of sources that share the energy equally, each a disc of an equal share of the area; none hidden."""
    offset = (
        reflectors.position[sources].astype(np.float64)[None]
        - reflectors.position[receivers].astype(np.float64)[:, None]
    )
    squared = np.maximum(np.einsum("rsi,rsi->rs", offset, offset), 1e-12)
    receiving = np.maximum(np.einsum("rsi,ri->rs", offset, reflectors.normal[receivers]), 0.0)
    sending = np.maximum(-np.einsum("rsi,si->rs", offset, reflectors.normal[sources]), 0.0)
    disc = area / (np.pi * sources.size)
    return np.asarray(
        energy / sources.size * (receiving * sending / (squared * (squared + disc))).sum(axis=1)
    )


def _only(channel: int, cut: float) -> NDArray[np.float32]:
    threshold = np.full(3, np.inf, dtype=np.float32)
    threshold[channel] = cut
    return threshold


def _thin(items: NDArray[np.integer], count: int) -> NDArray[np.int64]:
    """About `count` of the items, evenly spread over their order."""
    step = max(1, items.size // count)
    return np.asarray(items[::step][:count], dtype=np.int64)
