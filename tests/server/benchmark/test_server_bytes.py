import numpy as np

from nearfield_server.benchmark.scenario import box_scenario
from nearfield_server.benchmark.server_bytes import touched_pixels, update_bytes
from nearfield_server.pipeline.packed_table import group_by_block, pack_gather_table
from nearfield_server.records import GatherTable, LightSettings


def test_pixels_without_weight_are_not_read() -> None:
    # Two texels in pixel 0 as it is, one in the middle of four pixels of which pixel 4 is shared with another.
    table = GatherTable(
        pair_start=np.array([0, 1, 2, 3, 4], dtype=np.int64),
        camera=np.array([0, 0, 0, 1], dtype=np.uint8),
        pixel=np.array([0, 0, 4, 4], dtype=np.uint32),
        fraction_x=np.array([0.0, 0.0, 0.5, 0.0], dtype=np.float32),
        fraction_y=np.array([0.0, 0.0, 0.5, 0.0], dtype=np.float32),
        weight=np.ones(4, dtype=np.float32),
        camera_shapes=((3, 3), (3, 3)),
    )
    assert touched_pixels(group_by_block(pack_gather_table(table))) == 1 + 4 + 1


def test_every_array_counts_once() -> None:
    scenario, settings = box_scenario(48), LightSettings(num_samples=64)
    texels, pairs = scenario.texels.area.size, scenario.table.pixel.size
    black = np.zeros((texels, 3), dtype=np.float32)
    found = update_bytes(scenario, settings, black, np.full(3, np.inf, dtype=np.float32))
    blocks = -(-texels // 64)
    pixels = touched_pixels(group_by_block(pack_gather_table(scenario.table)))
    assert found["gather"] == (
        12 * pairs + 8 * (4 * blocks + 1) + texels + 8 * pixels + 4 * texels + 12 * texels + 13 * blocks
    )
    # Nothing is direct: only the maxima are looked at.
    assert found["integrate"] == 12 * blocks
    lit = update_bytes(scenario, settings, black, np.zeros(3, dtype=np.float32))
    assert lit["integrate"] == 12 * blocks + 40 * 64 * blocks
