import numpy as np
import pytest
from scipy.stats import chisquare

from nearfield_server.pipeline.blocks import BlockPool
from nearfield_server.pipeline.gather import block_maxima
from nearfield_server.pipeline.sampling import sample_direct_texels, stratified_pattern


def _sample(
    radiance: np.ndarray, area: np.ndarray, threshold: np.ndarray, count: int, pool: BlockPool, seed: int = 1
):
    return sample_direct_texels(
        radiance, area, threshold, block_maxima(radiance), stratified_pattern(count, seed), pool
    )


def _density(radiance: np.ndarray, area: np.ndarray, threshold: np.ndarray) -> np.ndarray:
    direct = np.where(radiance >= threshold, radiance, 0.0).astype(np.float64)
    return direct.mean(axis=1) * area.astype(np.float64)


def _atlas(num_texels: int = 3000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(11)
    radiance = rng.exponential(size=(num_texels, 3)).astype(np.float32)
    threshold = np.array([1.0, 2.0, 0.5], dtype=np.float32)
    return radiance, rng.uniform(1e-4, 5e-4, num_texels).astype(np.float32), threshold


def test_samples_follow_their_density(pool: BlockPool) -> None:
    radiance, area, threshold = _atlas(200)
    weights = _density(radiance, area, threshold)
    rng = np.random.default_rng(3)
    # Unstratified positions: chi-square assumes independent draws.
    positions = np.sort(rng.random(200_000))
    chosen, total = sample_direct_texels(radiance, area, threshold, block_maxima(radiance), positions, pool)
    assert total == pytest.approx(weights.sum(), rel=1e-12)
    counts = np.bincount(chosen, minlength=weights.size)
    assert not counts[weights == 0.0].any()
    lit = weights > 0.0
    assert chisquare(counts[lit], weights[lit] / weights.sum() * positions.size).pvalue > 1e-3


def test_strata_bound_the_count_of_every_texel(pool: BlockPool) -> None:
    radiance, area, threshold = _atlas()
    weights = _density(radiance, area, threshold)
    chosen, total = _sample(radiance, area, threshold, 4096, pool)
    expected = weights / total * 4096
    counts = np.bincount(chosen, minlength=weights.size)
    assert (np.abs(counts - expected) < 2.0).all()


def test_equals_the_inverse_of_a_plain_cumulative_sum(pool: BlockPool) -> None:
    radiance, area, threshold = _atlas()
    cumulative = np.cumsum(_density(radiance, area, threshold))
    expected = np.searchsorted(cumulative, stratified_pattern(4096, 1) * cumulative[-1], side="right")
    chosen, _ = _sample(radiance, area, threshold, 4096, pool)
    # Sums in another order may move a position across a border between texels.
    assert (chosen != expected).mean() < 1e-3


def test_the_pattern_is_fixed_and_stratified() -> None:
    pattern = stratified_pattern(1000, 5)
    np.testing.assert_array_equal(pattern, stratified_pattern(1000, 5))
    np.testing.assert_array_equal(np.floor(pattern * 1000), np.arange(1000))


def test_nothing_direct_gives_no_samples(pool: BlockPool) -> None:
    radiance, area, _ = _atlas()
    chosen, total = _sample(radiance, area, np.full(3, np.inf, dtype=np.float32), 64, pool)
    assert chosen.size == 0
    assert total == 0.0


def test_the_last_position_stays_inside(pool: BlockPool) -> None:
    radiance = np.zeros((200, 3), dtype=np.float32)
    radiance[[3, 77]] = 1.0 / 3.0
    area = np.full(200, 0.1, dtype=np.float32)
    positions = np.array([0.0, np.nextafter(1.0, 0.0)])
    threshold = np.full(3, 0.1, dtype=np.float32)
    chosen, _ = sample_direct_texels(radiance, area, threshold, block_maxima(radiance), positions, pool)
    np.testing.assert_array_equal(chosen, [3, 77])
