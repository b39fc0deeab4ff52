"""The light stages as GLSL compute shaders (OpenGL 4.3), for machines with a real GPU.

Everything that scales with the atlas runs on the device; what comes back is a few kilobytes per stage: block sums, sampled
texels, cluster sums, coefficients, what the receivers of hidden lamps show. Partial sums are float32 per work group and added
in float64 here. The k-means on the few thousand samples stays on the processor: it is one millisecond there, and its slots and
generations are bookkeeping, not arithmetic.

Same results as `pipeline.backend.CpuBackend` and `reference`, up to float32 sums (tested on llvmpipe).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import GraphicsError
from nearfield_server.gpu.context import GlContext, open_context
from nearfield_server.gpu.hidden_lamps import SHADERS as HIDDEN_SHADERS
from nearfield_server.gpu.hidden_lamps import HiddenLamps
from nearfield_server.gpu.programs import load_compute
from nearfield_server.pipeline.auto_split import AutoSplit
from nearfield_server.pipeline.backend import Gathered, Tiles
from nearfield_server.pipeline.blocks import NORMAL_SCALE, cluster_features, make_blocks
from nearfield_server.pipeline.gather import frame_pointers
from nearfield_server.pipeline.integration import ValSums, lights_from_sums
from nearfield_server.pipeline.packed_table import PackedTable, pack_gather_table
from nearfield_server.pipeline.reflections import REFLECTED_SHARE, make_reflectors, reflected_share
from nearfield_server.pipeline.sampling import stratified_pattern
from nearfield_server.pipeline.sh_projection import weighted_basis
from nearfield_server.pipeline.split import COARSE_BINS

if TYPE_CHECKING:
    from nearfield_server.pipeline.backend import BackendSetup

_GROUPS: Final = 64
"""Work groups of the reductions over all texels; each leaves one row of partial sums."""
_CANDIDATES: Final = 16
_DIGIT_SHIFTS: Final = tuple(range(28, -1, -4))
_COLUMNS: Final = 17
_SHADERS: Final = (
    "gather",
    "fill",
    "energy_above",
    "histogram",
    "block_weights",
    "pick",
    "integrate",
    "project_sh",
    *HIDDEN_SHADERS,
)
_MAX_CAMERAS: Final = 16
_PIXEL_BYTES: Final = 8
_CAMERA_SHIFT: Final = 28


def create_light_backend(setup: BackendSetup, *, allow_software: bool) -> GlBackend:
    """Open a context and put the static inputs on the device.

    Args:
        setup: static inputs of the stages.
        allow_software: accept a software renderer (llvmpipe, softpipe), on which the numba kernels are many times faster.

    Raises:
        GraphicsError: there is no OpenGL 4.3 context, or it is a software renderer and that is not allowed.
    """
    context = open_context()
    if context.is_software and not allow_software:
        context.release()
        raise GraphicsError(f"renderer {context.renderer!r} is software: the CPU kernels are faster")
    try:
        return GlBackend(setup, context)
    except BaseException:
        context.release()
        raise


def _pair_words(table: PackedTable) -> NDArray[np.uint32]:
    """(P, 3) uint32: camera and pixel, upper taps, lower taps; never empty."""
    place = (table.camera.astype(np.uint32) << np.uint32(_CAMERA_SHIFT)) | table.pixel
    words = np.concatenate([place[:, None], table.taps.view(np.uint32)], axis=1)
    return words if words.size else np.zeros((1, 3), dtype=np.uint32)


class GlBackend:
    """Implements `pipeline.backend.StageBackend` on an OpenGL device. Use it from the thread that made it."""

    name = "gl"

    def __init__(self, setup: BackendSetup, context: GlContext) -> None:
        self._context = context
        self.is_software = context.is_software
        self._settings = setup.settings
        self._pattern = stratified_pattern(setup.settings.num_samples, setup.settings.seed)
        self._threshold = np.full(3, np.inf, dtype=np.float32)
        self._auto_split = AutoSplit()
        self._reflectors = make_reflectors(setup.mesh, setup.texels)
        blocks = make_blocks(setup.texels)
        table = pack_gather_table(setup.table)
        self._position, self._normal = blocks.position, blocks.normal
        self._num_texels, self._num_blocks = blocks.num_texels, blocks.num_blocks
        self._total_area = float(blocks.area.sum(dtype=np.float64))
        self._origin = blocks.position.mean(axis=0, dtype=np.float64)
        self._camera_shapes = table.camera_shapes
        self._programs = {name: load_compute(context, f"light_{name}.comp") for name in _SHADERS}
        upload = context.storage_buffer
        self._pairs = upload(_pair_words(table))
        self._pair_start = upload(table.pair_start.astype(np.uint32))
        self._area = upload(blocks.area)
        geometry = np.zeros((self._num_texels, 2, 4), dtype=np.float32)
        geometry[:, 0, :3] = blocks.position - self._origin
        geometry[:, 0, 3] = blocks.area
        geometry[:, 1, :3] = blocks.normal
        self._geometry = upload(geometry)
        self._num_fill = int(setup.fill_texels.size)
        fill = np.stack([setup.fill_texels, setup.fill_sources], axis=1).astype(np.uint32)
        self._fill = upload(fill if self._num_fill else np.zeros((1, 2), dtype=np.uint32))
        self._radiance = upload(np.zeros((self._num_texels, 3), dtype=np.float32))
        self._hidden = None if setup.hidden is None else HiddenLamps(context, setup.hidden)
        sizes = [height * width for height, width in self._camera_shapes]
        self._camera_first = np.concatenate([[0], np.cumsum(sizes)])[: len(sizes)].astype(np.int64)
        self._pixels = context.reserve_buffer(max(1, sum(sizes)) * _PIXEL_BYTES)
        self._histogram = context.reserve_buffer(COARSE_BINS * 4)
        self._above = context.reserve_buffer(_GROUPS * 3 * _CANDIDATES * 4)
        self._block_sums = context.reserve_buffer(self._num_blocks * 16)
        num_samples = setup.settings.num_samples
        self._sample_block = context.reserve_buffer(num_samples * 4)
        self._sample_rest = context.reserve_buffer(num_samples * 4)
        self._sample_texel = context.reserve_buffer(num_samples * 4)
        self._centres = context.reserve_buffer(setup.settings.num_vals * 6 * 4)
        self._partial = context.reserve_buffer(_GROUPS * setup.settings.num_vals * _COLUMNS * 4)
        self._coefficients = context.reserve_buffer(27 * 4)
        self._bases: dict[int, Any] = {}
        self._probes: dict[int, tuple[NDArray[np.int32], Any]] = {}

    def gather(self, frames: Sequence[NDArray[np.float16] | None], tiles: Tiles | None = None) -> Gathered:
        """See `StageBackend`. Pictures are copied to the device as they are (half floats), and all texels are gathered."""
        frame_pointers(frames, self._camera_shapes)
        first = np.zeros(_MAX_CAMERAS, dtype=np.uint32)
        width = np.zeros(_MAX_CAMERAS, dtype=np.uint32)
        for camera, pixels in enumerate(frames):
            if pixels is not None:
                first[camera] = self._camera_first[camera]
                width[camera] = pixels.shape[1]
                self._pixels.write(pixels, offset=int(first[camera]) * _PIXEL_BYTES)
        self._run(
            "gather",
            self._num_blocks,
            [self._pairs, self._pair_start, self._pixels, self._radiance],
            uNumTexels=self._num_texels,
            uCameraFirst=first.tolist(),
            uCameraWidth=width.tolist(),
        )
        if self._num_fill:
            groups = -(-self._num_fill // 64)
            self._run("fill", groups, [self._fill, self._radiance], uNumFill=self._num_fill)
        if self._hidden is not None:
            self._hidden.update(self._radiance, self._run)
        return Gathered()

    def split(self) -> NDArray[np.float32]:
        """See `StageBackend`."""
        ratio = self._settings.split_ratio
        self._threshold = self._auto_threshold() if ratio is None else self._ratio_threshold(ratio)
        return self._threshold

    def direct_changed(self) -> bool:
        """See `StageBackend`. The device does not compare radiance with that of the last update: always taken for granted."""
        return True

    def sample(self) -> NDArray[np.float64]:
        """See `StageBackend`."""
        chosen = self.pick(self._threshold)
        return cluster_features(self._position[chosen], self._normal[chosen])

    def pick(self, threshold: NDArray[np.float32]) -> NDArray[np.int64]:
        """See `reflections.TexelPicker`."""
        self._run(
            "block_weights",
            self._num_blocks,
            [self._radiance, self._area, self._block_sums],
            uNumTexels=self._num_texels,
            uThreshold=threshold.tolist(),
        )
        weights = self._read(self._block_sums, np.float32).reshape(-1, 4)[:, 3].astype(np.float64)
        cumulative = np.cumsum(weights)
        total = float(cumulative[-1])
        if not total > 0.0:
            return np.zeros(0, dtype=np.int64)
        positions = self._pattern * total
        block = np.searchsorted(cumulative, positions, side="right")
        block = np.minimum(block, np.flatnonzero(weights)[-1])
        rest = np.maximum(positions - (cumulative - weights)[block], 0.0)
        self._sample_block.write(block.astype(np.uint32))
        self._sample_rest.write(rest.astype(np.float32))
        self._run(
            "pick",
            -(-block.size // 64),
            [self._radiance, self._area, self._sample_block, self._sample_rest, self._sample_texel],
            uNumTexels=self._num_texels,
            uNumSamples=block.size,
            uThreshold=threshold.tolist(),
        )
        return self._read(self._sample_texel, np.int32).astype(np.int64)

    def radiance_of(self, texel: NDArray[np.int64], channel: int) -> NDArray[np.float64]:
        """See `reflections.TexelPicker`. Reads the whole atlas back; only asked for when the light has changed."""
        return np.asarray(self.texel_radiance()[texel, channel], dtype=np.float64)

    def integrate(self, centres: NDArray[np.float64], alive: NDArray[np.bool_]) -> ValSums:
        """See `StageBackend`."""
        living = np.flatnonzero(alive)
        sums = np.zeros((centres.shape[0], _COLUMNS))
        if living.size:
            local = centres[living].copy()
            local[:, :3] -= self._origin
            self._centres.write(local.astype(np.float32))
            self._partial.clear()
            self._run(
                "integrate",
                _GROUPS,
                [self._radiance, self._geometry, self._centres, self._partial],
                uNumTexels=self._num_texels,
                uNumSlots=living.size,
                uNormalScale=NORMAL_SCALE,
                uThreshold=self._threshold.tolist(),
            )
            partial = self._read(self._partial, np.float32)[: _GROUPS * living.size * _COLUMNS]
            sums[living] = partial.reshape(_GROUPS, living.size, _COLUMNS).sum(axis=0, dtype=np.float64)
        return lights_from_sums(sums, self._origin, centres)

    def project_sh(self, probe_texel: NDArray[np.int32], resolution: int) -> NDArray[np.float64]:
        """See `StageBackend`. The probe is uploaded once and kept while the caller keeps passing the same array."""
        if resolution not in self._bases:
            self._bases[resolution] = self._context.storage_buffer(
                weighted_basis(resolution).astype(np.float32)
            )
        self._run(
            "project_sh",
            1,
            [self._radiance, self._probe(probe_texel), self._bases[resolution], self._coefficients],
            uNumPixels=probe_texel.size,
            uThreshold=self._threshold.tolist(),
        )
        return self._read(self._coefficients, np.float32).reshape(9, 3).astype(np.float64)

    def texel_radiance(self) -> NDArray[np.float32]:
        """See `StageBackend`. Reads the whole atlas back."""
        return self._read(self._radiance, np.float32).reshape(-1, 3)

    def release(self) -> None:
        """Free the device. The backend must not be used afterwards."""
        self._context.release()

    def _probe(self, probe_texel: NDArray[np.int32]) -> Any:
        kept = self._probes.get(id(probe_texel))
        if kept is None or kept[0] is not probe_texel:
            if len(self._probes) >= 64:
                for _, buffer in self._probes.values():
                    buffer.release()
                self._probes.clear()
            kept = (probe_texel, self._context.storage_buffer(probe_texel))
            self._probes[id(probe_texel)] = kept
        return kept[1]

    def _energy_above(self, prefix: NDArray[np.uint32], shift: int) -> NDArray[np.float64]:
        """(3, 16) sum of L dA over texels with bits >= prefix + (i << shift)."""
        self._run(
            "energy_above",
            _GROUPS,
            [self._radiance, self._area, self._above],
            uNumTexels=self._num_texels,
            uPrefix=prefix.tolist(),
            uShift=shift,
        )
        bins = (
            self._read(self._above, np.float32).reshape(_GROUPS, 3, _CANDIDATES).sum(axis=0, dtype=np.float64)
        )
        return np.cumsum(bins[:, ::-1], axis=1)[:, ::-1]

    def _ratio_threshold(self, ratio: float) -> NDArray[np.float32]:
        """Largest threshold whose direct part reaches the ratio: a radix search over the bits of the float."""
        prefix = np.zeros(3, dtype=np.uint32)
        target: NDArray[np.float64] | None = None
        total = np.zeros(3)
        for shift in _DIGIT_SHIFTS:
            above = self._energy_above(prefix, shift)
            if target is None:
                total = above[:, 0]
                # Float32 partial sums may miss the whole by a few ulp; a ratio of 1 must still be reachable.
                target = ratio * total * (1.0 - 1e-6)
            digit = (above >= target[:, None]).sum(axis=1) - 1
            prefix = prefix + (np.maximum(digit, 0).astype(np.uint32) << np.uint32(shift))
        threshold = prefix.view(np.float32).copy()
        threshold[~(total > 0.0)] = np.inf
        return threshold

    def _auto_threshold(self) -> NDArray[np.float32]:
        histogram = np.zeros((3, COARSE_BINS), dtype=np.int64)
        total = self._energy_above(np.zeros(3, dtype=np.uint32), 28)[:, 0]
        # Rounding adds at most half a count per texel, and the total is known to about 1e-6: keep that much room below 2^32.
        room = (2.0**32 - self._num_texels) * (1.0 - 1e-5)
        scale = room / float(total.max()) if total.max() > 0.0 else 1.0
        for channel in np.flatnonzero(total > 0.0):
            self._histogram.clear()
            self._run(
                "histogram",
                -(-self._num_texels // 256),
                [self._radiance, self._area, self._histogram],
                uNumTexels=self._num_texels,
                uChannel=int(channel),
                uScale=scale,
            )
            histogram[channel] = self._read(self._histogram, np.uint32)
        return self._auto_split.choose(
            histogram,
            scale,
            self._total_area,
            lambda *cuts: reflected_share(self._reflectors, self, *cuts) >= REFLECTED_SHARE,
        )

    def _run(self, name: str, groups: int, buffers: Sequence[Any], **uniforms: object) -> None:
        program = self._programs[name]
        for binding, buffer in enumerate(buffers):
            buffer.bind_to_storage_buffer(binding)
        for key, value in uniforms.items():
            program[key].value = value
        program.run(group_x=groups)
        self._context.storage_barrier()

    def _read(self, buffer: Any, dtype: type[np.generic]) -> NDArray[Any]:
        return np.frombuffer(buffer.read(), dtype=dtype)
