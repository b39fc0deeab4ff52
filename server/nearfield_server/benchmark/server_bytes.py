"""The bytes that a whole light update must read and write at least: each array once, as it lies in memory.

Counted from the actual tables, pictures and light of a scenario, stage by stage, so that the count can be checked. A stage may not
do with less; caches may not help, because the whole of it is larger than they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nearfield_server.benchmark.scenario import Scenario
from nearfield_server.pipeline.blocks import BLOCK, direct_blocks
from nearfield_server.pipeline.gather import block_maxima
from nearfield_server.pipeline.levels import LEVELS
from nearfield_server.pipeline.packed_table import (
    TEXEL_BITS,
    BlockTable,
    group_by_block,
    pack_gather_table,
    repeat_pairs,
)
from nearfield_server.pipeline.runner import PROBE_RESOLUTION
from nearfield_server.pipeline.sh_projection import weighted_basis
from nearfield_server.records import LightSettings, ObjectPose

_PIXEL: int = 8  # four half floats
_RADIANCE: int = 12  # three floats
_PLACE: int = 24  # position and normal
_AREA: int = 4
_POINT: int = 48  # six doubles of cluster space


def update_bytes(
    scenario: Scenario,
    settings: LightSettings,
    radiance: NDArray[np.float32],
    threshold: NDArray[np.float32],
) -> dict[str, int]:
    """Bytes by stage for an update in which all pictures are new and no object moved.

    Args:
        scenario: room, pictures and objects.
        settings: of the light extraction; the threshold is taken to come from the atlas (no ratio).
        radiance: (N, 3) of an update.
        threshold: (3,) of that update.
    """
    table = _block_table(scenario)
    texels, blocks = radiance.shape[0], table.num_blocks
    maxima = block_maxima(radiance).nbytes
    direct = direct_blocks(block_maxima(radiance), threshold).size * BLOCK
    probes = [scenario.probes.trace(_centre(pose), PROBE_RESOLUTION) for pose in scenario.objects]
    seen = sum(np.unique(probe[probe >= 0]).size for probe in probes)
    return {
        "gather": table.target.nbytes
        + table.taps.nbytes
        + table.segment_start.nbytes
        + table.seen.nbytes
        + _PIXEL * touched_pixels(table)
        + _AREA * texels
        + _RADIANCE * texels
        + maxima
        + blocks,
        "split": 3 * LEVELS * 8,
        "sample": maxima + (_RADIANCE + _AREA) * direct + (_PLACE + _POINT) * settings.num_samples,
        "cluster": _POINT * settings.num_samples,
        "integrate": maxima + (_RADIANCE + _AREA + _PLACE) * direct,
        "sh": sum(probe.nbytes for probe in probes)
        + _RADIANCE * seen
        + (weighted_basis(PROBE_RESOLUTION).nbytes if probes else 0),
    }


def touched_pixels(table: BlockTable) -> int:
    """Pixels of all cameras that count with any weight for any texel, each once."""
    num_cameras = max(1, len(table.camera_shapes))
    camera = np.repeat(np.arange(table.segment_start.size - 1) % num_cameras, np.diff(table.segment_start))
    total = 0
    for index, (height, width) in enumerate(table.camera_shapes):
        own = camera == index
        pixel = (table.target[own] >> np.uint32(TEXEL_BITS)).astype(np.int64)
        touched = np.zeros(height * width, dtype=np.bool_)
        for tap, offset in enumerate((0, 1, width, width + 1)):
            touched[(pixel + offset)[table.taps[own, tap] > 0]] = True
        total += int(touched.sum())
    return total


def _block_table(scenario: Scenario) -> BlockTable:
    table, fill = scenario.table, scenario.unseen_fill
    if fill is not None:
        usable = fill.source >= 0
        table = repeat_pairs(table, fill.texel[usable], fill.source[usable])
    return group_by_block(pack_gather_table(table))


def _centre(pose: ObjectPose) -> NDArray[np.float64]:
    return pose.world_from_object[:3, :3] @ pose.centre_object + pose.world_from_object[:3, 3]
