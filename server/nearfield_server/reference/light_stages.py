"""The light stages as plain float64 numpy, behind the same interface as the fast ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nearfield_server.pipeline.auto_split import AutoSplit
from nearfield_server.pipeline.backend import BackendSetup, Gathered, Tiles
from nearfield_server.pipeline.blocks import NORMAL_SCALE
from nearfield_server.pipeline.integration import ValSums
from nearfield_server.pipeline.levels import energy_scale, level_energy
from nearfield_server.pipeline.packed_table import PackedTable
from nearfield_server.pipeline.reflections import REFLECTED_SHARE, make_reflectors, reflected_share
from nearfield_server.pipeline.sampling import stratified_pattern
from nearfield_server.pipeline.split import fixed_point_scale
from nearfield_server.radiometry.cube import cube_directions, cube_solid_angles
from nearfield_server.radiometry.sh import project_samples
from nearfield_server.records import GatherTable
from nearfield_server.reference.hidden_light import estimate_hidden_radiance_reference


def gather_reference(table: GatherTable, frames: Sequence[NDArray[np.float16] | None]) -> NDArray[np.float64]:
    """(N, 3) radiance per texel from the unpacked table; the oracle of `pipeline.gather.gather`.

    Every tap counts with its bilinear weight times the pair's weight times its validity; NaN and negative values count
    as 0 and infinity as the largest half.
    """
    num_texels = table.pair_start.shape[0] - 1
    texel_of_pair = np.repeat(np.arange(num_texels), np.diff(table.pair_start))
    total = np.zeros((num_texels, 4))
    for camera, pixels in enumerate(frames):
        if pixels is None:
            continue
        height, width = table.camera_shapes[camera]
        picture = _clean(pixels)
        pairs = np.flatnonzero(table.camera == camera)
        row, column = np.divmod(table.pixel[pairs].astype(np.int64), width)
        fraction_x, fraction_y = (
            table.fraction_x[pairs].astype(np.float64),
            table.fraction_y[pairs].astype(np.float64),
        )
        for down, weight_y in ((0, 1.0 - fraction_y), (1, fraction_y)):
            for right, weight_x in ((0, 1.0 - fraction_x), (1, fraction_x)):
                tap = picture[np.minimum(row + down, height - 1), np.minimum(column + right, width - 1)]
                weight = table.weight[pairs].astype(np.float64) * weight_x * weight_y
                for component in range(4):
                    weighted = tap[:, component] * weight
                    total[:, component] += np.bincount(texel_of_pair[pairs], weighted, num_texels)
    return _blend(total)


def packed_gather_reference(
    table: PackedTable, frames: Sequence[NDArray[np.float16] | None]
) -> NDArray[np.float64]:
    """(N, 3) radiance per texel from the rounded weights of the packed table; otherwise as `gather_reference`."""
    texel = np.repeat(np.arange(table.num_texels), np.diff(table.pair_start))
    total = np.zeros((table.num_texels, 4))
    for camera, pixels in enumerate(frames):
        if pixels is None:
            continue
        picture = _clean(pixels).reshape(-1, 4)
        pairs = np.flatnonzero(table.camera == camera)
        width = table.camera_shapes[camera][1]
        for tap, offset in enumerate((0, 1, width, width + 1)):
            values = picture[table.pixel[pairs].astype(np.int64) + offset]
            np.add.at(total, texel[pairs], values * table.taps[pairs, tap].astype(np.float64)[:, None])
    return _blend(total)


def _clean(pixels: NDArray[np.float16]) -> NDArray[np.float64]:
    """Float64 pixels without NaN, infinity and negative values, everything multiplied by validity."""
    picture = np.nan_to_num(pixels.astype(np.float64), nan=0.0, posinf=65504.0, neginf=0.0).clip(0.0, 65504.0)
    return np.asarray(picture * picture[..., 3:])


def _blend(total: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 3) colour sums divided by the valid weight, 0 where there is none."""
    valid = total[:, 3:] > 0.0
    return np.asarray(np.where(valid, total[:, :3] / np.where(valid, total[:, 3:], 1.0), 0.0))


def ratio_threshold_reference(
    radiance: NDArray[np.floating], area: NDArray[np.floating], ratio: float
) -> NDArray[np.float64]:
    """Threshold per channel by sorting all texels: the oracle of `pipeline.split.ratio_threshold`.

    Sums are exact integers (Python's own), so equal sums are equal whatever the order.
    """
    threshold = np.full(3, np.inf)
    total_area = float(area.sum(dtype=np.float64))
    scale = fixed_point_scale(float(radiance.max(initial=0.0)), total_area)
    for channel in range(3):
        value = radiance[:, channel].astype(np.float64)
        energy = np.rint(value * area.astype(np.float64) * scale).astype(np.int64)
        order = np.argsort(-value, kind="stable")
        cumulative = np.cumsum(energy[order])
        total = int(cumulative[-1]) if cumulative.size else 0
        if total > 0:
            target = min(int(np.ceil(ratio * total)), total)
            threshold[channel] = value[order[np.searchsorted(cumulative, target)]]
    return threshold


def integrate_reference(
    position: NDArray[np.floating],
    normal: NDArray[np.floating],
    area: NDArray[np.floating],
    radiance: NDArray[np.floating],
    threshold: NDArray[np.floating],
    centres: NDArray[np.float64],
    alive: NDArray[np.bool_],
) -> ValSums:
    """Brute-force Eq. 7, cluster by cluster; the oracle of `pipeline.integration.integrate`."""
    num_slots = centres.shape[0]
    sums = ValSums(
        radiant_intensity=np.zeros((num_slots, 3)),
        position=np.zeros((num_slots, 3)),
        normal=np.zeros((num_slots, 3)),
        area=np.zeros(num_slots),
    )
    direct = (
        np.where(radiance >= threshold, radiance, 0.0).astype(np.float64) * area.astype(np.float64)[:, None]
    )
    texels = np.flatnonzero(direct.any(axis=1))
    if texels.size == 0 or not alive.any():
        return sums
    points, normals = position[texels].astype(np.float64), normal[texels].astype(np.float64)
    features = np.concatenate([points, NORMAL_SCALE * normals], axis=1)
    distance = np.stack([np.sum((features - centre) ** 2, axis=1) for centre in centres], axis=1)
    label = np.where(alive, distance, np.inf).argmin(axis=1)
    for slot in np.unique(label):
        members = label == slot
        energy = direct[texels[members]]
        weight = energy.sum(axis=1) / energy.sum()
        centre = weight @ points[members]
        mean_normal = weight @ normals[members]
        mean_normal /= np.linalg.norm(mean_normal)
        offset = points[members] - centre
        across = offset - np.outer(offset @ mean_normal, mean_normal)
        sums.radiant_intensity[slot] = energy.sum(axis=0)
        sums.position[slot] = centre
        sums.normal[slot] = mean_normal
        sums.area[slot] = 2.0 * np.pi * (weight @ np.sum(across**2, axis=1)) + weight @ area[texels[members]]
    return sums


class ReferenceBackend:
    """`pipeline.backend.StageBackend` made of the oracles."""

    name = "reference"

    def __init__(self, setup: BackendSetup) -> None:
        self._setup = setup
        self._radiance = np.zeros((setup.texels.area.shape[0], 3))
        self._threshold = np.full(3, np.inf, dtype=np.float32)
        self._auto_split = AutoSplit()
        self._reflectors = make_reflectors(setup.mesh, setup.texels)

    def gather(self, frames: Sequence[NDArray[np.float16] | None], tiles: Tiles | None = None) -> Gathered:
        """See `StageBackend`. Everything anew, whatever `tiles` says."""
        self._radiance = gather_reference(self._setup.table, frames)
        self._radiance[self._setup.fill_texels] = self._radiance[self._setup.fill_sources]
        hidden = self._setup.hidden
        if hidden is not None:
            values = estimate_hidden_radiance_reference(hidden, self._radiance)
            self._radiance[hidden.texels] = values[hidden.group]
        return Gathered()

    def split(self) -> NDArray[np.float32]:
        """See `StageBackend`."""
        area, ratio = self._setup.texels.area, self._setup.settings.split_ratio
        # The rank is decided among float32 values: the threshold is one.
        radiance = self._radiance.astype(np.float32)
        self._radiance = radiance.astype(np.float64)
        if ratio is not None:
            self._threshold = ratio_threshold_reference(radiance, area, ratio).astype(np.float32)
        else:
            scale = energy_scale(area)
            energy = level_energy(radiance, area, scale)
            total_area = float(area.sum(dtype=np.float64))
            self._threshold = self._auto_split.choose(
                energy,
                scale,
                total_area,
                lambda *cuts: reflected_share(self._reflectors, self, *cuts) >= REFLECTED_SHARE,
            )
        return self._threshold

    def direct_changed(self) -> bool:
        """See `StageBackend`. Always taken for granted."""
        return True

    def sample(self) -> NDArray[np.float64]:
        """See `StageBackend`."""
        texels, chosen = self._setup.texels, self.pick(self._threshold)
        features = [
            texels.position[chosen].astype(np.float64),
            NORMAL_SCALE * texels.normal[chosen].astype(np.float64),
        ]
        return np.concatenate(features, axis=1)

    def pick(self, threshold: NDArray[np.float32]) -> NDArray[np.int64]:
        """See `reflections.TexelPicker`."""
        texels, settings = self._setup.texels, self._setup.settings
        direct = np.where(self._radiance >= threshold, self._radiance, 0.0)
        cumulative = np.cumsum(direct.sum(axis=1) * texels.area.astype(np.float64))
        if not cumulative[-1] > 0.0:
            return np.zeros(0, dtype=np.int64)
        pattern = stratified_pattern(settings.num_samples, settings.seed)
        return np.asarray(np.searchsorted(cumulative, pattern * cumulative[-1], side="right"), dtype=np.int64)

    def radiance_of(self, texel: NDArray[np.int64], channel: int) -> NDArray[np.float64]:
        """See `reflections.TexelPicker`."""
        return np.asarray(self._radiance[texel, channel])

    def integrate(self, centres: NDArray[np.float64], alive: NDArray[np.bool_]) -> ValSums:
        """See `StageBackend`."""
        texels = self._setup.texels
        return integrate_reference(
            texels.position, texels.normal, texels.area, self._radiance, self._threshold, centres, alive
        )

    def project_sh(self, probe_texel: NDArray[np.int32], resolution: int) -> NDArray[np.float64]:
        """See `StageBackend`."""
        indirect = np.where(self._radiance < self._threshold, self._radiance, 0.0)
        seen = np.where((probe_texel >= 0)[:, None], indirect[probe_texel], 0.0)
        return project_samples(cube_directions(resolution), cube_solid_angles(resolution), seen)

    def texel_radiance(self) -> NDArray[np.float32]:
        """See `StageBackend`."""
        return self._radiance.astype(np.float32)
