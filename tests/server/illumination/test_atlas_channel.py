"""The streamed atlas: radiance times area is kept, rims are not black, only changes travel."""

from __future__ import annotations

import numpy as np
import pytest

from nearfield_protocol.codec import decode_radiance, paste_tiles
from nearfield_server.illumination.atlas_channel import AtlasChannel, build_downsampler, downsample_atlas
from nearfield_server.records import TexelGeometry

SIZE = 64


def _texels(covered: np.ndarray, area: np.ndarray | None = None) -> TexelGeometry:
    height, width = covered.shape
    index = np.flatnonzero(covered).astype(np.int32)
    count = len(index)
    none = np.zeros(0, np.int32)
    return TexelGeometry(
        height=height,
        width=width,
        texel_index=index,
        position=np.zeros((count, 3), np.float32),
        normal=np.zeros((count, 3), np.float32),
        area=np.ones(count, np.float32) if area is None else area.astype(np.float32),
        face=np.zeros(count, np.int32),
        lookup=np.full(covered.shape, -1, np.int32),
        gutter_texel=none,
        gutter_source=none,
    )


@pytest.fixture
def charts() -> np.ndarray:
    covered = np.zeros((300, 260), np.bool_)
    covered[20:150, 10:100] = True
    covered[170:280, 90:251] = True
    return covered


def test_radiance_times_area_is_kept(charts: np.ndarray) -> None:
    rng = np.random.default_rng(3)
    texels = _texels(charts, rng.uniform(0.1, 2.0, int(charts.sum())))
    radiance = rng.uniform(0, 50, (len(texels.area), 3)).astype(np.float32)
    sampler = build_downsampler(texels, SIZE)
    cells = downsample_atlas(sampler, radiance).reshape(-1, 3).astype(np.float64)
    covered = sampler.inverse_area > 0
    total = (cells[covered] / sampler.inverse_area[covered, None]).sum(0)
    np.testing.assert_allclose(total, (radiance.astype(np.float64) * texels.area[:, None]).sum(0), rtol=1e-6)


def test_a_constant_room_stays_constant_up_to_two_cells_outside_its_charts(charts: np.ndarray) -> None:
    texels = _texels(charts)
    radiance = np.full((len(texels.area), 3), 3.0, np.float32)
    cells = downsample_atlas(build_downsampler(texels, SIZE), radiance)
    rows, columns = np.nonzero(charts)
    covered = np.zeros((SIZE, SIZE), np.bool_)
    covered[rows * SIZE // 300, columns * SIZE // 260] = True
    wide = covered.copy()
    for row, column in np.argwhere(covered):
        wide[max(0, row - 2) : row + 3, max(0, column - 2) : column + 3] = True
    np.testing.assert_allclose(cells[wide], 3.0, rtol=1e-6)
    assert not cells[~wide].any()


def test_bilinear_lookups_inside_a_chart_never_blend_in_black(charts: np.ndarray) -> None:
    texels = _texels(charts)
    cells = downsample_atlas(build_downsampler(texels, SIZE), np.ones((len(texels.area), 3), np.float32))[
        ..., 0
    ]
    rows, columns = np.nonzero(charts)
    x = (columns + 0.5) / 260 * SIZE - 0.5
    y = (rows + 0.5) / 300 * SIZE - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    for dy in (0, 1):
        for dx in (0, 1):
            np.testing.assert_allclose(cells[y0 + dy, x0 + dx], 1.0, rtol=1e-6)


def test_pasting_all_changes_gives_the_newest_atlas(charts: np.ndarray) -> None:
    texels = _texels(charts)
    sampler = build_downsampler(texels, SIZE)
    channel = AtlasChannel(sampler, room_revision=9)
    received = np.zeros((SIZE, SIZE), np.uint32)
    rng = np.random.default_rng(0)
    radiance = rng.uniform(0, 4, (len(texels.area), 3)).astype(np.float32)
    for step in range(4):
        tiles = channel.changes(radiance, step)
        assert tiles is not None
        assert (tiles.sequence, tiles.timestamp_ns, tiles.room_revision) == (step + 1, step, 9)
        paste_tiles(received, tiles)
        expected = downsample_atlas(sampler, radiance)
        bound = 0.00196 * expected.max(-1, keepdims=True) + 3e-8
        assert (np.abs(decode_radiance(received) - expected) <= bound).all()
        radiance = radiance.copy()
        radiance[: 40 * (step + 1)] *= 2


def test_an_unchanged_atlas_sends_nothing_and_a_restart_sends_all(charts: np.ndarray) -> None:
    texels = _texels(charts)
    channel = AtlasChannel(build_downsampler(texels, SIZE), room_revision=0)
    radiance = np.ones((len(texels.area), 3), np.float32)
    first = channel.changes(radiance, 0)
    assert first is not None
    assert len(first.positions) == (SIZE // 32) ** 2
    assert channel.changes(radiance, 1) is None
    channel.restart()
    again = channel.changes(radiance, 2)
    assert again is not None
    assert len(again.positions) == (SIZE // 32) ** 2


def test_one_texel_changes_one_tile(charts: np.ndarray) -> None:
    texels = _texels(charts)
    channel = AtlasChannel(build_downsampler(texels, SIZE), room_revision=0)
    radiance = np.ones((len(texels.area), 3), np.float32)
    channel.changes(radiance, 0)
    radiance = radiance.copy()
    middle = int(np.flatnonzero(texels.texel_index == 60 * 260 + 40)[0])
    radiance[middle] = 100
    tiles = channel.changes(radiance, 1)
    assert tiles is not None
    np.testing.assert_array_equal(tiles.positions, [[0, 0]])
