from dataclasses import replace

import numpy as np
import pytest

from nearfield_server.errors import ConfigError
from nearfield_server.pipeline.blocks import BlockPool, make_blocks
from nearfield_server.pipeline.gather import block_maxima, gather, pack_gather_table
from nearfield_server.records import GatherTable
from nearfield_server.reference.box_room import BoxRoom, RadianceField
from nearfield_server.reference.light_stages import gather_reference


def _quantised(table: GatherTable) -> GatherTable:
    """The table as the packed one holds it, so that the comparison is about arithmetic alone."""
    return replace(
        table,
        fraction_x=(np.rint(table.fraction_x.astype(np.float64) * 255.0) / 255.0).astype(np.float32),
        fraction_y=(np.rint(table.fraction_y.astype(np.float64) * 255.0) / 255.0).astype(np.float32),
        weight=np.maximum(np.rint(table.weight.astype(np.float64) * 65535.0), 1.0).astype(np.float32),
    )


def _run(
    table: GatherTable, frames: list, pool: BlockPool, **fill: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    num_texels = table.pair_start.size - 1
    radiance = np.full((num_texels, 3), 99.0, dtype=np.float32)
    block_max = np.empty((-(-num_texels // 64), 3), dtype=np.float32)
    gather(pack_gather_table(table), frames, radiance, block_max, pool, **fill)
    return radiance, block_max


def _noise_pictures(room: BoxRoom, seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    pictures = []
    for height, width in room.table.camera_shapes:
        pixels = np.ones((height, width, 4), dtype=np.float16)
        pixels[..., :3] = 10.0 ** rng.uniform(-3.0, 4.0, (height, width, 3))
        pixels[..., 3] = rng.random((height, width)) < 0.8
        pictures.append(pixels)
    return pictures


@pytest.mark.parametrize("missing", [(), (1,), (0, 2, 3), (0, 1, 2, 3)])
def test_matches_float64(room: BoxRoom, pool: BlockPool, missing: tuple[int, ...]) -> None:
    pictures = [None if k in missing else picture for k, picture in enumerate(_noise_pictures(room, 5))]
    radiance, block_max = _run(room.table, pictures, pool)
    expected = gather_reference(_quantised(room.table), pictures)
    np.testing.assert_allclose(radiance, expected, rtol=2e-6, atol=1e-30)
    np.testing.assert_array_equal(block_max, block_maxima(radiance))


def test_recovers_a_smooth_field(room: BoxRoom, pool: BlockPool) -> None:
    def field(points: np.ndarray, face: np.ndarray) -> np.ndarray:
        return 2.0 + np.stack([points[:, 0], points[:, 1], points[:, 2]], axis=1) / 3.0

    radiance, _ = _run(room.table, [room.picture(k, field) for k in range(4)], pool)
    # The kink of the field at the room's edges blurs in a picture of 96 x 96 pixels; elsewhere it is smooth.
    error = np.abs(radiance / room.texel_field(field) - 1.0)
    assert np.median(error) < 1e-3
    assert np.quantile(error, 0.99) < 0.02


def test_constant_pictures_give_that_constant_in_every_seen_texel(room: BoxRoom, pool: BlockPool) -> None:
    pictures = [np.ones((*shape, 4), dtype=np.float16) for shape in room.table.camera_shapes]
    radiance, _ = _run(room.table, pictures, pool)
    np.testing.assert_allclose(radiance[np.diff(room.table.pair_start) > 0], 1.0, rtol=1e-6)


def test_invalid_pixels_do_not_leak(room: BoxRoom, pool: BlockPool, two_lamps: RadianceField) -> None:
    pictures = _noise_pictures(room, 6)
    poisoned = [picture.copy() for picture in pictures]
    for clean, bad in zip(pictures, poisoned, strict=True):
        bad[clean[..., 3] == 0.0, :3] = np.float16(np.nan)
    np.testing.assert_array_equal(_run(room.table, pictures, pool)[0], _run(room.table, poisoned, pool)[0])


def test_result_does_not_depend_on_threads(room: BoxRoom, pool: BlockPool) -> None:
    pictures = _noise_pictures(room, 7)
    np.testing.assert_array_equal(
        _run(room.table, pictures, pool)[0], _run(room.table, pictures, BlockPool(1))[0]
    )


def test_snapped_taps_ignore_bright_neighbours(pool: BlockPool) -> None:
    # One texel per pixel of a 3x3 picture, every fraction 0: also the last column and row, which have no neighbour.
    table = GatherTable(
        pair_start=np.arange(10, dtype=np.int64),
        camera=np.zeros(9, dtype=np.uint8),
        pixel=np.arange(9, dtype=np.uint32),
        fraction_x=np.zeros(9, dtype=np.float32),
        fraction_y=np.zeros(9, dtype=np.float32),
        weight=np.ones(9, dtype=np.float32),
        camera_shapes=((3, 3),),
    )
    pixels = np.ones((3, 3, 4), dtype=np.float16)
    pixels[..., 0] = np.array([[65504, 1e-3, 65504], [1e-3, 65504, 1e-3], [65504, 1e-3, 65504]])
    radiance, _ = _run(table, [pixels], pool)
    np.testing.assert_array_equal(radiance[:, 0], pixels[..., 0].ravel().astype(np.float32))


def test_unseen_texels_are_black_or_filled(room: BoxRoom, pool: BlockPool) -> None:
    table = _without_texel(room.table, 100)
    pictures = _noise_pictures(room, 8)
    assert not _run(table, pictures, pool)[0][100].any()
    fill = {"fill_texels": np.array([100], dtype=np.int32), "fill_sources": np.array([7], dtype=np.int32)}
    radiance, block_max = _run(table, pictures, pool, **fill)
    np.testing.assert_array_equal(radiance[100], radiance[7])
    assert (block_max[100 // 64] >= radiance[100]).all()


def _without_texel(table: GatherTable, texel: int) -> GatherTable:
    first, last = table.pair_start[texel], table.pair_start[texel + 1]
    keep = np.ones(table.pixel.size, dtype=bool)
    keep[first:last] = False
    start = table.pair_start.copy()
    start[texel + 1 :] -= last - first
    per_pair = {
        name: getattr(table, name)[keep] for name in ("camera", "pixel", "fraction_x", "fraction_y", "weight")
    }
    return replace(table, pair_start=start, **per_pair)


def test_read_only_pictures_are_accepted(room: BoxRoom, pool: BlockPool) -> None:
    pictures = _noise_pictures(room, 9)
    expected = _run(room.table, pictures, pool)[0]
    for picture in pictures:
        picture.flags.writeable = False
    np.testing.assert_array_equal(_run(room.table, pictures, pool)[0], expected)


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


def test_unusable_pictures_are_refused(room: BoxRoom, pool: BlockPool) -> None:
    pictures = _noise_pictures(room, 10)
    with pytest.raises(ConfigError, match="expected 4"):
        _run(room.table, pictures[:3], pool)
    for bad in (pictures[0][:-1], pictures[0].astype(np.float32), pictures[0][:, ::-1]):
        with pytest.raises(ConfigError, match="camera 0"):
            _run(room.table, [bad, *pictures[1:]], pool)


def test_texels_with_broken_geometry_are_refused(room: BoxRoom) -> None:
    area = room.texels.area.copy()
    area[3] = np.nan
    with pytest.raises(ConfigError, match="not finite"):
        make_blocks(replace(room.texels, area=area))
