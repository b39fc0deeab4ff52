from dataclasses import replace

import numpy as np
import pytest

from nearfield_server.errors import ConfigError
from nearfield_server.pipeline.packed_table import TEXEL_BITS, group_by_block, pack_gather_table, repeat_pairs
from nearfield_server.records import GatherTable
from nearfield_server.reference.box_room import BoxRoom, hide_texels


def _one_pair(**change: object) -> GatherTable:
    values: dict = {
        "pair_start": np.array([0, 1], dtype=np.int64),
        "camera": np.zeros(1, dtype=np.uint8),
        "pixel": np.zeros(1, dtype=np.uint32),
        "fraction_x": np.zeros(1, dtype=np.float32),
        "fraction_y": np.zeros(1, dtype=np.float32),
        "weight": np.ones(1, dtype=np.float32),
        "camera_shapes": ((3, 3),),
    }
    return GatherTable(**{**values, **change})


def test_taps_are_the_products_of_fractions_and_weight(room: BoxRoom) -> None:
    packed = pack_gather_table(room.table)
    x, y = room.table.fraction_x.astype(np.float64), room.table.fraction_y.astype(np.float64)
    taps = np.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], axis=1)
    taps *= room.table.weight.astype(np.float64)[:, None]
    texel = np.repeat(np.arange(packed.num_texels), np.diff(packed.pair_start))
    largest = np.zeros(packed.num_texels)
    np.maximum.at(largest, texel, taps.max(axis=1))
    np.testing.assert_allclose(packed.taps, taps / largest[texel, None] * 2**15, atol=0.500001)


@pytest.mark.parametrize(
    ("pixel", "expected"), [(0, [1, 0, 0, 0]), (2, [0, 1, 0, 0]), (6, [0, 0, 1, 0]), (8, [0, 0, 0, 1])]
)
def test_a_pixel_on_the_last_column_or_row_becomes_another_tap(pixel: int, expected: list[int]) -> None:
    packed = pack_gather_table(_one_pair(pixel=np.array([pixel], dtype=np.uint32)))
    np.testing.assert_array_equal(packed.taps[0], np.array(expected) << 15)
    assert packed.pixel[0] in (0, 1, 3, 4)


def test_a_camera_of_tiny_weight_still_counts() -> None:
    table = _one_pair(
        pair_start=np.array([0, 2], dtype=np.int64),
        camera=np.array([0, 1], dtype=np.uint8),
        pixel=np.zeros(2, dtype=np.uint32),
        fraction_x=np.full(2, 0.4, dtype=np.float32),
        fraction_y=np.zeros(2, dtype=np.float32),
        weight=np.array([1.0, 1e-9], dtype=np.float32),
        camera_shapes=((3, 3), (3, 3)),
    )
    np.testing.assert_array_equal(pack_gather_table(table).taps[1], [1, 0, 0, 0])


def test_blocks_hold_the_same_pairs(room: BoxRoom) -> None:
    packed = pack_gather_table(room.table)
    blocks = group_by_block(packed)
    segment = np.repeat(np.arange(blocks.segment_start.size - 1), np.diff(blocks.segment_start))
    texel = segment // 4 * 64 + (blocks.target & 63)
    order = np.lexsort((segment % 4, texel))
    np.testing.assert_array_equal(
        texel[order], np.repeat(np.arange(packed.num_texels), np.diff(packed.pair_start))
    )
    np.testing.assert_array_equal((segment % 4)[order], packed.camera)
    np.testing.assert_array_equal((blocks.target >> TEXEL_BITS)[order], packed.pixel)
    np.testing.assert_array_equal(blocks.taps[order], packed.taps)


def test_repeated_texels_have_the_pairs_of_their_source(room: BoxRoom) -> None:
    hidden = np.zeros(room.texels.area.size, dtype=bool)
    hidden[[5, 700]] = True
    table = repeat_pairs(
        hide_texels(room.table, hidden), np.array([5, 700], dtype=np.int32), np.array([9, 6], dtype=np.int32)
    )
    full = room.table
    for texel, source in ((5, 9), (700, 6), (6, 6), (701, 701)):
        found = slice(*table.pair_start[texel : texel + 2])
        expected = slice(*full.pair_start[source : source + 2])
        for name in ("camera", "pixel", "fraction_x", "fraction_y", "weight"):
            np.testing.assert_array_equal(getattr(table, name)[found], getattr(full, name)[expected])


def test_a_table_without_pairs_is_packed() -> None:
    none = np.zeros(0)
    table = _one_pair(
        pair_start=np.zeros(2, dtype=np.int64),
        camera=none.astype(np.uint8),
        pixel=none.astype(np.uint32),
        fraction_x=none.astype(np.float32),
        fraction_y=none.astype(np.float32),
        weight=none.astype(np.float32),
        camera_shapes=(),
    )
    blocks = group_by_block(pack_gather_table(table))
    assert not blocks.seen.any()
    assert blocks.num_blocks == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"camera_shapes": ((96, 96),) * 3}, "names camera 3"),
        ({"camera_shapes": ((8, 8),) * 4}, "outside"),
        ({"camera_shapes": ((96, 96),) * 17}, "17 cameras"),
        ({"camera_shapes": ((1, 96),) * 4}, "2x2"),
    ],
)
def test_unusable_tables_are_refused(room: BoxRoom, change: dict, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        pack_gather_table(replace(room.table, **change))
