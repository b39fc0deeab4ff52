"""k-means of importance samples into virtual area lights, as printed (Rohmer et al. 2014, section 4.3, Eq. 7; Dong et al. 2009)."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.benchmark.methods.atlas_split import AtlasSplit
from nearfield_server.benchmark.methods.light import (
    AtlasSample,
    MethodLight,
    Surroundings,
    make_vals,
    no_vals,
    object_sh,
)
from nearfield_server.pipeline.blocks import cluster_features

_NUM_SAMPLES: Final = 4096
_ITERATIONS: Final = 20


class ClusteredLights:
    """4k samples, 20 iterations from a fixed start, every direct texel to its nearest centre, area = sum of areas.

    Without a split this is the paper's "clustered VPL"; with one it is the paper's method. Nothing is kept from picture to picture.
    """

    def __init__(self, surroundings: Surroundings, num_lights: int, ratio: float | None) -> None:
        """Prepare.

        Args:
            surroundings: static inputs.
            num_lights: M.
            ratio: share of the light that becomes direct, None = no split.
        """
        self._surroundings, self._num_lights = surroundings, num_lights
        self._atlas = AtlasSplit(surroundings.texels.area, ratio, _NUM_SAMPLES)
        self._features = cluster_features(surroundings.texels.position, surroundings.texels.normal)

    def extract(self, sample: AtlasSample) -> MethodLight:
        """Sample, cluster, integrate."""
        threshold, chosen, _ = self._atlas.split(sample.radiance)
        below = self._atlas.indirect_threshold(threshold)
        count = len(self._surroundings.object_probes)
        coeffs = (
            np.zeros((count, 9, 3), np.float32)
            if below is None
            else object_sh(self._surroundings, sample.radiance, below)
        )
        if not len(chosen):
            return MethodLight(vals=no_vals(), object_sh=coeffs)
        points = self._features[chosen]
        start = np.linspace(0, len(points) - 1, self._num_lights).round().astype(np.int64)
        centres = lloyd(points, points[start], _ITERATIONS)
        sums = _integrate(self._features, self._surroundings.texels.area, sample.radiance, threshold, centres)
        return MethodLight(vals=_lights(sums), object_sh=coeffs)


def lloyd(points: NDArray[np.float64], centres: NDArray[np.float64], iterations: int) -> NDArray[np.float64]:
    """Lloyd's iteration: (M, 6) centres of (S, 6) points; a centre without points stays where it was."""
    centres = centres.copy()
    for _ in range(iterations):
        _move(points, centres)
    return centres


@njit(cache=True, nogil=True, inline="always")  # type: ignore[untyped-decorator]
def _nearest(point: Any, centres: Any) -> int:
    best, chosen = np.inf, 0
    for slot in range(centres.shape[0]):
        distance = 0.0
        for axis in range(6):
            difference = point[axis] - centres[slot, axis]
            distance += difference * difference
        if distance < best:
            best, chosen = distance, slot
    return chosen


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _move(points: Any, centres: Any) -> None:
    total = np.zeros(centres.shape)
    count = np.zeros(centres.shape[0])
    for k in range(points.shape[0]):
        slot = _nearest(points[k], centres)
        count[slot] += 1.0
        for axis in range(6):
            total[slot, axis] += points[k, axis]
    for slot in range(centres.shape[0]):
        if count[slot] > 0.0:
            for axis in range(6):
                centres[slot, axis] = total[slot, axis] / count[slot]


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _integrate(features: Any, area: Any, radiance: Any, threshold: Any, centres: Any) -> Any:
    """(M, 11): I (3), sum of areas, grey weight, weight * feature (6)."""
    sums = np.zeros((centres.shape[0], 11))
    for texel in range(area.shape[0]):
        weight, slot = 0.0, -1
        for channel in range(3):
            value = radiance[texel, channel]
            if value >= threshold[channel] and value > 0.0:
                if slot < 0:
                    slot = _nearest(features[texel], centres)
                energy = np.float64(value) * np.float64(area[texel])
                sums[slot, channel] += energy
                weight += energy / 3.0
        if slot >= 0:
            sums[slot, 3] += area[texel]
            sums[slot, 4] += weight
            for axis in range(6):
                sums[slot, 5 + axis] += weight * features[texel, axis]
    return sums


def _lights(sums: NDArray[np.float64]) -> NDArray[np.void]:
    lit = sums[:, 4] > 0.0
    mean = sums[:, 5:] / np.where(lit, sums[:, 4], 1.0)[:, None]
    length = np.linalg.norm(mean[:, 3:], axis=1, keepdims=True)
    normal = np.where(length > 0.0, mean[:, 3:] / np.where(length > 0.0, length, 1.0), [0.0, -1.0, 0.0])
    return make_vals(mean[:, :3], normal, sums[:, :3], sums[:, 3])[lit]
