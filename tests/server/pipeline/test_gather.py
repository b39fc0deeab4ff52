import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from nearfield_server.errors import ConfigError
from nearfield_server.pipeline.blocks import BlockPool, make_blocks
from nearfield_server.pipeline.gather import black_atlas, block_maxima, gather
from nearfield_server.pipeline.levels import level_energy
from nearfield_server.pipeline.packed_table import group_by_block, pack_gather_table
from nearfield_server.pipeline.tile_index import index_tiles
from nearfield_server.records import GatherTable
from nearfield_server.reference.box_room import BoxRoom, RadianceField, hide_texels
from nearfield_server.reference.light_stages import gather_reference, packed_gather_reference


def _run(table: GatherTable, frames: list, pool: BlockPool) -> tuple[np.ndarray, np.ndarray]:
    atlas = black_atlas(np.ones(table.pair_start.size - 1, dtype=np.float32))
    gather(group_by_block(pack_gather_table(table)), frames, atlas, pool)
    return atlas.radiance, atlas.block_max


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
    expected = packed_gather_reference(pack_gather_table(room.table), pictures)
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


def test_lower_bounds_weigh_as_measurements(room: BoxRoom, pool: BlockPool) -> None:
    pictures = _noise_pictures(room, 6)
    marked = [picture.copy() for picture in pictures]
    rng = np.random.default_rng(8)
    for share, picture in zip((0.0, 0.3, 0.7, 1.0), marked, strict=True):
        bound = (picture[..., 3] == 1) & (rng.random(picture.shape[:2]) < share)
        picture[bound, 3] = np.nextafter(np.float16(1), np.float16(0))
    expected, found = _run(room.table, pictures, pool)[0], _run(room.table, marked, pool)[0]
    assert np.any(found != expected)
    # Weights change by at most twice 2^-11, the share that alpha lacks.
    np.testing.assert_allclose(found, expected, rtol=2**-10 * 1.001)


def test_result_does_not_depend_on_threads(room: BoxRoom, pool: BlockPool) -> None:
    pictures = _noise_pictures(room, 7)
    np.testing.assert_array_equal(
        _run(room.table, pictures, pool)[0], _run(room.table, pictures, BlockPool(1))[0]
    )


def test_no_kernel_uses_memory_that_it_gave_back() -> None:
    """With this setting glibc overwrites memory as soon as it is freed, so what still uses it gives other results."""
    command = [sys.executable, "-m", "pytest", "-q", __file__, "-k", "does_not_depend_on_threads"]
    run = subprocess.run(command, env=os.environ | {"MALLOC_PERTURB_": "165"}, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout


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


def test_rounded_weights_are_those_of_the_table(
    room: BoxRoom, pool: BlockPool, two_lamps: RadianceField
) -> None:
    pictures = [room.picture(k, two_lamps) for k in range(4)]
    radiance, _ = _run(room.table, pictures, pool)
    # Each of a texel's taps is off by half a step of 2^-15 of the largest; the contrast of neighbours is up to 150.
    np.testing.assert_allclose(radiance, gather_reference(room.table, pictures), rtol=150 * 8 * 2.0**-16)


def test_texels_without_pairs_are_left_alone(room: BoxRoom, pool: BlockPool) -> None:
    hidden = np.zeros(room.texels.area.size, dtype=bool)
    hidden[100] = True
    table = group_by_block(pack_gather_table(hide_texels(room.table, hidden)))
    atlas = black_atlas(room.texels.area)
    atlas.radiance[100] = [9e4, 8e4, 7e4]
    gather(table, _noise_pictures(room, 8), atlas, pool)
    np.testing.assert_array_equal(atlas.radiance[100], np.float32([9e4, 8e4, 7e4]))
    np.testing.assert_array_equal(atlas.block_max, block_maxima(atlas.radiance))


def test_energy_is_counted_by_level(room: BoxRoom, pool: BlockPool) -> None:
    atlas = black_atlas(room.texels.area)
    table = group_by_block(pack_gather_table(room.table))
    for seed in (3, 4):
        gather(table, _noise_pictures(room, seed), atlas, pool)
        np.testing.assert_array_equal(
            atlas.energy, level_energy(atlas.radiance, atlas.area, atlas.energy_scale)
        )


@pytest.mark.parametrize("broken", [0.0, 0.02])
def test_any_sequence_of_partial_gathers_equals_whole_ones(
    room: BoxRoom, pool: BlockPool, broken: float
) -> None:
    table = group_by_block(pack_gather_table(room.table))
    partial, whole = black_atlas(room.texels.area), black_atlas(room.texels.area)
    rng = np.random.default_rng(12)
    original, pictures = _noise_pictures(room, 12), _noise_pictures(room, 12)
    index = index_tiles(table)
    gather(table, pictures, partial, pool)
    gather(table, pictures, whole, BlockPool(1))
    for _ in range(300):
        tiles = [np.zeros(shape, dtype=bool) for shape in index.tile_shapes]
        camera = int(rng.integers(4))
        row, column = (int(value) for value in rng.integers(0, 96, 2))
        picture = pictures[camera]
        patch = picture[row : row + int(rng.integers(1, 20)), column : column + int(rng.integers(1, 20))]
        patch[...] = original[camera][row : row + patch.shape[0], column : column + patch.shape[1]]
        patch[..., :3] *= np.float16(rng.choice([0.0, 0.5, 1.0]))
        if rng.random() < broken * 10:
            patch[..., int(rng.integers(4))] = np.float16(rng.choice([np.nan, np.inf, -np.inf, -1.0, 0.0]))
        tiles[camera][
            row // 32 : (row + patch.shape[0] - 1) // 32 + 1,
            column // 32 : (column + patch.shape[1] - 1) // 32 + 1,
        ] = True
        before = partial.radiance.copy()
        changed = gather(table, pictures, partial, pool, blocks=index.blocks_of(tiles, table.num_blocks))
        expected = gather(table, pictures, whole, BlockPool(1))
        np.testing.assert_array_equal(changed, expected)
        differs = np.flatnonzero((before != partial.radiance).any(axis=1))
        np.testing.assert_array_equal(np.flatnonzero(changed), np.unique(differs // 64))
        np.testing.assert_array_equal(partial.radiance, whole.radiance)
        np.testing.assert_array_equal(partial.block_max, whole.block_max)
        np.testing.assert_array_equal(partial.energy, whole.energy)
    assert np.isfinite(partial.radiance).all()
    np.testing.assert_array_equal(
        partial.energy, level_energy(partial.radiance, partial.area, partial.energy_scale)
    )


def test_read_only_pictures_are_accepted(room: BoxRoom, pool: BlockPool) -> None:
    pictures = _noise_pictures(room, 9)
    expected = _run(room.table, pictures, pool)[0]
    for picture in pictures:
        picture.flags.writeable = False
    np.testing.assert_array_equal(_run(room.table, pictures, pool)[0], expected)


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
