"""What a set of light stages must offer, whatever it runs on, and the processor's implementation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from nearfield_server.pipeline.auto_split import AutoSplit
from nearfield_server.pipeline.blocks import BlockPool, TexelBlocks, cluster_features, make_blocks
from nearfield_server.pipeline.gather import black_atlas, gather
from nearfield_server.pipeline.hidden_light import HiddenLight
from nearfield_server.pipeline.hidden_texels import HiddenTexels
from nearfield_server.pipeline.integration import ValSums, integrate
from nearfield_server.pipeline.packed_table import group_by_block, pack_gather_table, repeat_pairs
from nearfield_server.pipeline.reflections import REFLECTED_SHARE, make_reflectors, reflected_share
from nearfield_server.pipeline.sampling import sample_direct_texels, stratified_pattern
from nearfield_server.pipeline.sh_projection import project_indirect
from nearfield_server.pipeline.split import ratio_threshold
from nearfield_server.pipeline.tile_index import index_tiles
from nearfield_server.records import GatherTable, LightSettings, RoomMesh, TexelGeometry

Tiles = Sequence[NDArray[np.bool_]]
"""Per camera (rows, columns) bool: tiles of the picture that differ from those of the last gather."""
_WHOLE_SHARE: Final = 0.6
"""Share of the blocks beyond which a partial gather costs as much as a whole one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BackendSetup:
    """Static inputs of the stages: everything that changes only with the room.

    Attributes:
        mesh, texels, table, settings: as given to `LightPipeline`.
        fill_texels: (U,) int32 texels that no camera sees. fill_sources: (U,) int32 texels whose radiance they repeat.
        hidden: surfaces that no camera sees any part of, or None where they stay black.
    """

    mesh: RoomMesh
    texels: TexelGeometry
    table: GatherTable
    settings: LightSettings
    fill_texels: NDArray[np.int32]
    fill_sources: NDArray[np.int32]
    hidden: HiddenLight | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Gathered:
    """What a gather did.

    Attributes:
        part: share of the blocks that were gathered.
        changed: (B,) bool, blocks of `blocks.BLOCK` texels with new radiance; None where the backend cannot tell.
    """

    part: float = 1.0
    changed: NDArray[np.bool_] | None = None

    @property
    def is_same(self) -> bool:
        """Whether the radiance is known to be what it was, bit for bit."""
        return self.changed is not None and not self.changed.any()


class StageBackend(Protocol):
    """The light stages. Radiance and threshold stay inside, on the device; each call uses the newest of both.

    Calls come from one thread, in the order of the methods below; any of them may be left out in an update. After a call that
    failed the next gather is a whole one.
    """

    name: str

    def gather(self, frames: Sequence[NDArray[np.float16] | None], tiles: Tiles | None = None) -> Gathered:
        """Blend the pictures (H, W, 4) of all cameras into radiance per texel; None where a camera has none yet.

        A backend may keep what `tiles` does not touch, if the result is the same bit for bit. None: everything may be new.
        """

    def split(self) -> NDArray[np.float32]:
        """Choose and keep the threshold (3,) of the gathered radiance; infinity where nothing is direct."""

    def direct_changed(self) -> bool:
        """Whether the last gather and split may have changed any direct texel."""

    def sample(self) -> NDArray[np.float64]:
        """(S, 6) points of cluster space with density proportional to direct L dA; (0, 6) where nothing is direct."""

    def integrate(self, centres: NDArray[np.float64], alive: NDArray[np.bool_]) -> ValSums:
        """Sum all direct texels into the VALs of their nearest centres (M, 6)."""

    def project_sh(self, probe_texel: NDArray[np.int32], resolution: int) -> NDArray[np.float64]:
        """(9, 3) sh_coeffs of the indirect radiance behind the cube pixels of a probe."""

    def texel_radiance(self) -> NDArray[np.float32]:
        """(N, 3) radiance in texel order; overwritten by the next `gather`."""


class CpuBackend:
    """The stages as numba kernels."""

    name = "cpu"

    def __init__(self, setup: BackendSetup, pool: BlockPool | None = None) -> None:
        self._pool = pool if pool is not None else BlockPool()
        self._blocks: TexelBlocks = make_blocks(setup.texels)
        # A texel that repeats another one shows the same pixels: no pass of its own, and its tiles are known.
        table = repeat_pairs(setup.table, setup.fill_texels, setup.fill_sources)
        self._table = group_by_block(pack_gather_table(table))
        self._tile_index = index_tiles(self._table)
        self._settings = setup.settings
        self._hidden = None if setup.hidden is None else HiddenTexels(setup.hidden, self._blocks.num_blocks)
        self._pattern = stratified_pattern(setup.settings.num_samples, setup.settings.seed)
        self._total_area = float(self._blocks.area.sum(dtype=np.float64))
        self._atlas = black_atlas(self._blocks.area)
        self._threshold = np.full(3, np.inf, dtype=np.float32)
        self._auto_split = AutoSplit()
        self._reached = np.zeros(3, dtype=np.float32)
        self._threshold_moved = False
        self._reflectors = make_reflectors(setup.mesh, setup.texels)

    def gather(self, frames: Sequence[NDArray[np.float16] | None], tiles: Tiles | None = None) -> Gathered:
        """See `StageBackend`."""
        atlas, num_blocks = self._atlas, self._blocks.num_blocks
        blocks = None if tiles is None else self._tile_index.blocks_of(tiles, num_blocks)
        if blocks is not None and blocks.size > _WHOLE_SHARE * num_blocks:
            blocks = None
        before = atlas.block_max.copy()
        changed = gather(self._table, frames, atlas, self._pool, blocks=blocks)
        if self._hidden is not None:
            self._hidden.update(atlas, changed)
        # The most that any texel with new radiance had before or has now can be: below the threshold no direct texel changed.
        highest = np.maximum(before[changed], atlas.block_max[changed])
        self._reached = highest.max(axis=0, initial=0.0)
        return Gathered(part=1.0 if blocks is None else blocks.size / num_blocks, changed=changed)

    def split(self) -> NDArray[np.float32]:
        """See `StageBackend`."""
        atlas, ratio = self._atlas, self._settings.split_ratio
        if ratio is not None:
            threshold = ratio_threshold(atlas.radiance, atlas.area, atlas.block_max, ratio, self._pool)
        else:
            energy = atlas.energy if self._hidden is None else atlas.energy + self._hidden.energy
            threshold = self._auto_split.choose(
                energy,
                atlas.energy_scale,
                self._total_area,
                lambda *cuts: reflected_share(self._reflectors, self, *cuts) >= REFLECTED_SHARE,
            )
        self._threshold_moved = not np.array_equal(threshold, self._threshold)
        self._threshold = threshold
        return threshold

    def direct_changed(self) -> bool:
        """See `StageBackend`."""
        return self._threshold_moved or bool((self._reached >= self._threshold).any())

    def sample(self) -> NDArray[np.float64]:
        """See `StageBackend`."""
        chosen = self.pick(self._threshold)
        return cluster_features(self._blocks.position[chosen], self._blocks.normal[chosen])

    def pick(self, threshold: NDArray[np.float32]) -> NDArray[np.int64]:
        """See `reflections.TexelPicker`."""
        atlas = self._atlas
        return sample_direct_texels(
            atlas.radiance, atlas.area, threshold, atlas.block_max, self._pattern, self._pool
        )[0]

    def radiance_of(self, texel: NDArray[np.int64], channel: int) -> NDArray[np.float64]:
        """See `reflections.TexelPicker`."""
        return np.asarray(self._atlas.radiance[texel, channel], dtype=np.float64)

    def integrate(self, centres: NDArray[np.float64], alive: NDArray[np.bool_]) -> ValSums:
        """See `StageBackend`."""
        atlas = self._atlas
        return integrate(
            self._blocks, atlas.radiance, atlas.block_max, self._threshold, centres, alive, self._pool
        )

    def project_sh(self, probe_texel: NDArray[np.int32], resolution: int) -> NDArray[np.float64]:
        """See `StageBackend`."""
        return project_indirect(probe_texel, resolution, self._atlas.radiance, self._threshold)

    def texel_radiance(self) -> NDArray[np.float32]:
        """See `StageBackend`."""
        return self._atlas.radiance
