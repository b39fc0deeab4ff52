"""The traps of light extraction, each with the way it fails in a careless implementation."""

import numpy as np
import pytest

from nearfield_server.pipeline.blocks import BlockPool, cluster_features, make_blocks
from nearfield_server.pipeline.clustering import empty_state, update_clusters
from nearfield_server.pipeline.gather import black_atlas, block_maxima, gather
from nearfield_server.pipeline.integration import integrate
from nearfield_server.pipeline.packed_table import group_by_block, pack_gather_table
from nearfield_server.pipeline.sampling import sample_direct_texels, stratified_pattern
from nearfield_server.pipeline.split import direct_totals, ratio_threshold
from nearfield_server.records import GatherTable
from nearfield_server.reference.box_room import make_box_room
from nearfield_server.reference.light_stages import ratio_threshold_reference

POOL = BlockPool(2)


def _threshold(radiance: np.ndarray, area: np.ndarray, ratio: float) -> np.ndarray:
    return ratio_threshold(radiance, area, block_maxima(radiance), ratio, POOL)


def _share(radiance: np.ndarray, area: np.ndarray, threshold: np.ndarray) -> np.ndarray:
    direct, total = direct_totals(radiance, area, threshold)
    return direct / total


@pytest.mark.parametrize("ratio", [0.3, 0.75, 1.0])
def test_a_plateau_at_the_threshold_stays_whole(ratio: float) -> None:
    # With '>' instead of '>=' the plateau is lost: shares 0.0 and 0.38 for 0.3 and 0.75.
    radiance = np.full((6000, 3), 2.0, dtype=np.float32)
    radiance[4000:] = 0.5
    area = np.full(6000, 1e-4, dtype=np.float32)
    threshold = _threshold(radiance, area, ratio)
    assert (_share(radiance, area, threshold) >= ratio).all()
    np.testing.assert_array_equal(threshold, 2.0 if ratio < 0.85 else 0.5)


def test_a_room_of_one_radiance_is_direct_as_a_whole_under_any_ratio() -> None:
    radiance = np.full((3000, 3), 0.1, dtype=np.float32)
    area = np.full(3000, 1e-4, dtype=np.float32)
    for ratio in (1e-3, 0.5, 1.0):
        np.testing.assert_array_equal(_threshold(radiance, area, ratio), np.float32(0.1))


def test_all_black_selects_nothing() -> None:
    # Threshold 0 with '>=' would select everything.
    radiance = np.zeros((1000, 3), dtype=np.float32)
    threshold = _threshold(radiance, np.ones(1000, dtype=np.float32), 0.9)
    assert not (radiance >= threshold).any()


def test_black_texels_are_never_direct() -> None:
    radiance = np.zeros((1000, 3), dtype=np.float32)
    radiance[7] = [1.0, 0.0, 1e-30]
    threshold = _threshold(radiance, np.ones(1000, dtype=np.float32), 1.0)
    np.testing.assert_array_equal(np.flatnonzero((radiance >= threshold).any(axis=1)), [7])
    assert np.isinf(threshold[1])


def test_texels_without_area_weigh_nothing() -> None:
    # Gutter texels repeat radiance: with an area they would count twice.
    rng = np.random.default_rng(1)
    radiance = rng.exponential(size=(500, 3)).astype(np.float32)
    area = rng.uniform(1e-4, 2e-4, 500).astype(np.float32)
    padded = np.concatenate([radiance, radiance * 9])
    padded_area = np.concatenate([area, np.zeros_like(area)])
    np.testing.assert_array_equal(_threshold(padded, padded_area, 0.9), _threshold(radiance, area, 0.9))


@pytest.mark.parametrize("exponents", [(-38, -30), (-7, -5), (-3, 4.8), (-38, 4.8)])
@pytest.mark.parametrize("ratio", [0.5, 0.9, 0.999])
def test_threshold_equals_a_full_sort_bit_for_bit(exponents: tuple[float, float], ratio: float) -> None:
    rng = np.random.default_rng(2)
    radiance = (10.0 ** rng.uniform(*exponents, (20000, 3))).astype(np.float32)
    area = (10.0 ** rng.uniform(-6, -3, 20000)).astype(np.float32)
    expected = ratio_threshold_reference(radiance, area, ratio).astype(np.float32)
    np.testing.assert_array_equal(_threshold(radiance, area, ratio), expected)


def test_fixed_point_sums_agree_with_float64_ranks() -> None:
    # Truncating float32 products at 2^-30 picks the neighbouring rank; here the sums are those of float64.
    rng = np.random.default_rng(3)
    radiance = (10.0 ** rng.uniform(-3, 3, (30000, 3))).astype(np.float32)
    area = rng.uniform(1e-4, 2e-4, 30000).astype(np.float32)
    threshold = _threshold(radiance, area, 0.8)
    for channel in range(3):
        order = np.argsort(-radiance[:, channel].astype(np.float64), kind="stable")
        energy = np.cumsum(radiance[order, channel].astype(np.float64) * area[order])
        expected = radiance[order[np.searchsorted(energy, 0.8 * energy[-1])], channel]
        assert threshold[channel] == expected


def test_one_bright_texel_and_a_million_dim_ones() -> None:
    # Sequential float32 sums give 1128.0 instead of 1104.86 here.
    radiance = np.full((1_000_001, 3), 1e-4, dtype=np.float32)
    radiance[0] = 1000.0
    area = np.ones(radiance.shape[0], dtype=np.float32)
    direct, total = direct_totals(radiance, area, np.full(3, 1e-5, dtype=np.float32))
    np.testing.assert_allclose(direct, 1000.0 + 1e6 * float(np.float32(1e-4)), rtol=1e-12)
    np.testing.assert_array_equal(_threshold(radiance, area, 0.9), 1000.0)
    np.testing.assert_array_equal(_threshold(radiance, area, 0.95), np.float32(1e-4))
    np.testing.assert_allclose(total, direct)


def test_a_lamp_before_dim_texels_does_not_kill_them() -> None:
    count = 100_000
    radiance = np.full((count, 3), 1e-3, dtype=np.float32)
    radiance[0] = 60000.0
    area = np.full(count, 1e-4, dtype=np.float32)
    single = np.cumsum(radiance[:, 0] * area, dtype=np.float32)
    assert (
        np.mean(np.diff(single) == 0.0) > 0.9
    )  # in float32 nearly all texels behind the lamp have probability 0
    dim_share = (count - 1) * 1e-3 / (60000.0 + (count - 1) * 1e-3)
    positions = 1.0 - np.linspace(0.999, 0.001, 1000) * dim_share
    chosen, _ = sample_direct_texels(
        radiance, area, np.zeros(3, dtype=np.float32), block_maxima(radiance), positions, POOL
    )
    np.testing.assert_allclose(chosen, np.linspace(0.001, 0.999, 1000) * count, atol=2.0)


def test_a_lamp_of_one_texel() -> None:
    radiance = np.full((5000, 3), 0.01, dtype=np.float32)
    radiance[1234] = 50000.0
    area = np.full(5000, 1e-4, dtype=np.float32)
    threshold = _threshold(radiance, area, 0.9)
    chosen, _ = sample_direct_texels(
        radiance, area, threshold, block_maxima(radiance), stratified_pattern(4096, 1), POOL
    )
    np.testing.assert_array_equal(chosen, 1234)
    points = np.repeat(cluster_features(np.array([[1.0, 2, 3]]), np.array([[0.0, 1, 0]])), 4096, axis=0)
    state = update_clusters(empty_state(16), points, 20)
    # Naive k-means on duplicates ends with 15 of 16 centres NaN.
    assert state.alive.sum() == 1
    assert np.isfinite(state.centres).all()


@pytest.mark.parametrize("num_slots", [8, 64])
def test_energy_balance_over_seven_decades(num_slots: int) -> None:
    room = make_box_room(atlas_size=96, num_cameras=1, camera_size=8)
    blocks = make_blocks(room.texels)
    rng = np.random.default_rng(4)
    radiance = (10.0 ** rng.uniform(-2.5, 4.5, (blocks.num_texels, 3))).astype(np.float32)
    threshold = _threshold(radiance, blocks.area, 0.98)
    chosen, total = sample_direct_texels(
        radiance, blocks.area, threshold, block_maxima(radiance), stratified_pattern(4096, 1), POOL
    )
    state = update_clusters(
        empty_state(num_slots), cluster_features(blocks.position[chosen], blocks.normal[chosen]), 20
    )
    vals = integrate(blocks, radiance, block_maxima(radiance), threshold, state.centres, state.alive, POOL)
    direct, _ = direct_totals(radiance, blocks.area, threshold)
    np.testing.assert_allclose(vals.radiant_intensity.sum(axis=0), direct, rtol=1e-8)
    assert total == pytest.approx(direct.mean(), rel=1e-12)


def _one_texel_table(shape: tuple[int, int]) -> GatherTable:
    height, width = shape
    return GatherTable(
        pair_start=np.array([0, 1], dtype=np.int64),
        camera=np.zeros(1, dtype=np.uint8),
        pixel=np.zeros(1, dtype=np.uint32),
        fraction_x=np.full(1, 0.5, dtype=np.float32),
        fraction_y=np.full(1, 0.5, dtype=np.float32),
        weight=np.ones(1, dtype=np.float32),
        camera_shapes=((height, width),),
    )


def _gather_one(pixels: np.ndarray) -> np.ndarray:
    atlas = black_atlas(np.ones(1, dtype=np.float32))
    gather(group_by_block(pack_gather_table(_one_texel_table((2, 2)))), [pixels], atlas, POOL)
    return atlas.radiance[0]


@pytest.mark.parametrize(("bad", "seen"), [(np.nan, 0.0), (np.inf, 65504.0), (-np.inf, 0.0), (-5.0, 0.0)])
def test_a_broken_pixel_that_slipped_through_does_not_spread(bad: float, seen: float) -> None:
    # inf * 0 in a bilinear blend turns 2029 infinite pixels into 2421 NaN texels, and one NaN into NaN everywhere.
    pixels = np.ones((2, 2, 4), dtype=np.float16)
    pixels[0, 0, :3] = bad
    np.testing.assert_allclose(_gather_one(pixels), 0.25 * seen + 0.75, rtol=1e-6)


def test_subnormal_halves_keep_their_value() -> None:
    pixels = np.ones((2, 2, 4), dtype=np.float16)
    pixels[..., :3] = np.float16(6e-8)
    np.testing.assert_allclose(_gather_one(pixels), np.float32(np.float16(6e-8)), rtol=1e-6)
