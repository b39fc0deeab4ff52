"""What a set of light stages must offer, whatever it runs on, and the processor's implementation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nearfield_server.pipeline import gather as gather_stage
from nearfield_server.pipeline.auto_split import AutoSplit
from nearfield_server.pipeline.blocks import BlockPool, TexelBlocks, cluster_features, make_blocks
from nearfield_server.pipeline.hidden_light import (
    HiddenLight,
    estimate_hidden_radiance,
    write_hidden_radiance,
)
from nearfield_server.pipeline.integration import ValSums, integrate
from nearfield_server.pipeline.sampling import sample_direct_texels, stratified_pattern
from nearfield_server.pipeline.sh_projection import project_indirect
from nearfield_server.pipeline.split import fixed_point_scale, radiance_histogram, ratio_threshold
from nearfield_server.records import GatherTable, LightSettings, RoomMesh, TexelGeometry


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


class StageBackend(Protocol):
    """The light stages. Radiance and threshold stay inside, on the device; each call uses the newest of both.

    Calls come from one thread, in the order of the methods below; any of them may be left out in an update.
    """

    name: str

    def gather(self, frames: Sequence[NDArray[np.float16] | None]) -> None:
        """Blend the pictures (H, W, 4) of all cameras into radiance per texel; None where a camera has none yet."""

    def split(self) -> NDArray[np.float32]:
        """Choose and keep the threshold (3,) of the gathered radiance; infinity where nothing is direct."""

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
        self._table = gather_stage.pack_gather_table(setup.table)
        self._settings = setup.settings
        self._fill_texels, self._fill_sources = setup.fill_texels, setup.fill_sources
        self._hidden = setup.hidden
        self._pattern = stratified_pattern(setup.settings.num_samples, setup.settings.seed)
        self._total_area = float(self._blocks.area.sum(dtype=np.float64))
        self._radiance = np.zeros((self._blocks.num_texels, 3), dtype=np.float32)
        self._block_max = np.zeros((self._blocks.num_blocks, 3), dtype=np.float32)
        self._threshold = np.full(3, np.inf, dtype=np.float32)
        self._auto_split = AutoSplit()

    def gather(self, frames: Sequence[NDArray[np.float16] | None]) -> None:
        """See `StageBackend`."""
        gather_stage.gather(
            self._table,
            frames,
            self._radiance,
            self._block_max,
            self._pool,
            fill_texels=self._fill_texels,
            fill_sources=self._fill_sources,
        )
        if self._hidden is not None:
            values = estimate_hidden_radiance(self._hidden, self._radiance)
            write_hidden_radiance(
                self._hidden.texels, self._hidden.group, values, self._radiance, self._block_max
            )

    def split(self) -> NDArray[np.float32]:
        """See `StageBackend`."""
        ratio = self._settings.split_ratio
        if ratio is not None:
            self._threshold = ratio_threshold(
                self._radiance, self._blocks.area, self._block_max, ratio, self._pool
            )
        else:
            scale = fixed_point_scale(float(self._block_max.max()), self._total_area)
            histogram = radiance_histogram(
                self._radiance, self._blocks.area, scale, self._blocks.num_blocks, self._pool
            )
            self._threshold = self._auto_split.choose(histogram, scale, self._total_area)
        return self._threshold

    def sample(self) -> NDArray[np.float64]:
        """See `StageBackend`."""
        chosen, _ = sample_direct_texels(
            self._radiance, self._blocks.area, self._threshold, self._block_max, self._pattern, self._pool
        )
        return cluster_features(self._blocks.position[chosen], self._blocks.normal[chosen])

    def integrate(self, centres: NDArray[np.float64], alive: NDArray[np.bool_]) -> ValSums:
        """See `StageBackend`."""
        return integrate(
            self._blocks, self._radiance, self._block_max, self._threshold, centres, alive, self._pool
        )

    def project_sh(self, probe_texel: NDArray[np.int32], resolution: int) -> NDArray[np.float64]:
        """See `StageBackend`."""
        return project_indirect(probe_texel, resolution, self._radiance, self._threshold)

    def texel_radiance(self) -> NDArray[np.float32]:
        """See `StageBackend`."""
        return self._radiance
