"""The judgement of the atlas: a perfect one has no error, a wrong one has the error that was put in."""

from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.errors import AssetError
from nearfield_server.evaluation.atlas_metrics import Cells, judge_atlas, load_cells, nearest_cells
from nearfield_server.records import GatherTable, TexelGeometry
from nearfield_server.scene.bundle import load_bundle


def grid(count, height, normal):
    u = (np.arange(count) + 0.5) / count
    x, z = np.meshgrid(u, u, indexing="ij")
    positions = np.stack([x, np.full_like(x, height), z], axis=-1).reshape(-1, 3)
    return positions, np.tile(normal, (len(positions), 1))


@pytest.fixture
def room():
    """A floor with a lamp 2 cm above it facing up, and the floor seen from below: three sheets of nearly one place."""
    sheets = [(0.0, [0.0, 1, 0]), (0.02, [0.0, 1, 0]), (0.0, [0.0, -1, 0])]

    def build(count):
        parts = [grid(count, height, normal) for height, normal in sheets]
        return tuple(np.concatenate(a) for a in zip(*parts, strict=True))

    centre, normal = build(25)
    light = np.repeat([-1, 0, -1], 625)
    radiance = np.repeat(np.array([[1.0, 2, 3], [10, 10, 10], [5, 5, 5]]), 625, axis=0)
    cells = Cells(centre=centre, normal=normal, radiance=radiance, light=light, valid=np.ones(1875, np.bool_))
    position, texel_normal = build(60)
    n = len(position)
    texels = TexelGeometry(
        height=1,
        width=n,
        texel_index=np.arange(n, dtype=np.int32),
        position=position.astype(np.float32),
        normal=texel_normal.astype(np.float32),
        area=np.full(n, 1 / 3600, np.float32),
        face=np.zeros(n, np.int32),
        lookup=np.arange(n, dtype=np.int32)[None],
        gutter_texel=np.zeros(0, np.int32),
        gutter_source=np.zeros(0, np.int32),
    )
    truth = np.repeat(np.array([[1.0, 2, 3], [10, 10, 10], [5, 5, 5]], np.float32), 3600, axis=0)
    return cells, texels, truth


def table_of(seen):
    start = np.concatenate([[0], np.cumsum(seen)]).astype(np.int64)
    n = int(start[-1])
    zeros = np.zeros(n, np.float32)
    return GatherTable(
        pair_start=start,
        camera=np.zeros(n, np.uint8),
        pixel=np.zeros(n, np.uint32),
        fraction_x=zeros,
        fraction_y=zeros,
        weight=zeros + 1,
        camera_shapes=((2, 2),),
    )


def test_texels_find_cells_of_their_own_plane_and_side(room):
    cells, texels, _ = room
    found = nearest_cells(texels.position, texels.normal, cells)
    np.testing.assert_array_equal(found // 625, np.repeat([0, 1, 2], 3600))


def test_perfect_atlas_has_no_error(room):
    cells, texels, truth = room
    metrics = judge_atlas(texels, table_of(np.ones(10800, int)), truth, cells)
    assert metrics.total_energy_error < 1e-6
    assert metrics.spurious_energy < 1e-6
    assert metrics.num_texels == 10800


def test_energy_put_onto_a_wall_is_found_and_energy_of_the_lamp_is_not_spurious(room):
    cells, texels, truth = room
    spoilt = truth.copy()
    spoilt[:3600] *= 1.5
    energy = 6.0 + 30.0 + 15.0
    metrics = judge_atlas(texels, table_of(np.ones(10800, int)), spoilt, cells)
    assert metrics.total_energy_error == pytest.approx(3.0 / energy, rel=1e-4)
    assert metrics.spurious_energy == pytest.approx(3.0 / energy, rel=1e-4)
    lamp = truth.copy()
    lamp[3600:7200] *= 1.5
    metrics = judge_atlas(texels, table_of(np.ones(10800, int)), lamp, cells)
    assert metrics.total_energy_error == pytest.approx(15.0 / energy, rel=1e-4)
    assert metrics.spurious_energy < 1e-6


def test_unseen_texels_do_not_count(room):
    cells, texels, truth = room
    spoilt = truth.copy()
    spoilt[7200:] = 1e6
    metrics = judge_atlas(texels, table_of(np.repeat([1, 1, 0], 3600)), spoilt, cells)
    assert metrics.total_energy_error < 1e-6
    assert metrics.num_texels == 7200


def test_cells_of_a_bundle_are_mixed_by_the_lights(tiny_room):
    bundle = load_bundle(tiny_room)
    nominal = load_cells(bundle.cells, bundle, np.ones(len(bundle.lights)))
    dark = load_cells(bundle.cells, bundle, np.zeros(len(bundle.lights)))
    assert not dark.radiance.any()
    for index, light in enumerate(bundle.lights):
        np.testing.assert_allclose(
            nominal.radiance[nominal.light == index],
            np.tile(light.radiance, (np.sum(nominal.light == index), 1)),
        )
        alone = load_cells(bundle.cells, bundle, np.eye(len(bundle.lights))[index])
        dark.radiance[:] += alone.radiance
    np.testing.assert_allclose(dark.radiance, nominal.radiance, rtol=1e-9)


def test_foreign_files_are_refused_in_words(tiny_room, tmp_path):
    bundle = load_bundle(tiny_room)
    path = tmp_path / "cells.npz"
    np.savez(path, centre=np.zeros((2, 3)))
    with pytest.raises(AssetError, match="radiance cells"):
        load_cells(path, bundle, np.ones(2))
    path.write_bytes(b"nothing")
    with pytest.raises(AssetError, match="radiance cells"):
        load_cells(path, bundle, np.ones(2))


def test_noise_is_not_spurious_and_missing_light_is_no_negative_excess(room):
    cells, texels, truth = room
    noisy = truth.copy()
    noisy[:3600] *= np.tile(np.array([[0.5], [1.5]], np.float32), (1800, 1))
    metrics = judge_atlas(texels, table_of(np.ones(10800, int)), noisy, cells)
    assert metrics.spurious_energy < 1e-6
    dark = judge_atlas(texels, table_of(np.ones(10800, int)), 0.5 * truth, cells)
    assert dark.spurious_energy == 0.0
    assert dark.total_energy_error == pytest.approx(0.5)
