import numpy as np
import pytest

from nearfield_server.pipeline.blocks import BlockPool
from nearfield_server.pipeline.gather import block_maxima
from nearfield_server.pipeline.split import direct_totals, ratio_threshold
from nearfield_server.reference.light_stages import ratio_threshold_reference

RATIOS = [1e-6, 0.1, 0.5, 0.75, 0.9, 0.98, 0.999999, 1.0]


def _threshold(radiance: np.ndarray, area: np.ndarray, ratio: float, pool: BlockPool) -> np.ndarray:
    return ratio_threshold(radiance, area, block_maxima(radiance), ratio, pool)


def _atlas(seed: int, num_texels: int = 5000, decades: float = 6.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    radiance = (10.0 ** rng.uniform(-decades / 2, decades / 2, (num_texels, 3))).astype(np.float32)
    radiance[rng.random(num_texels) < 0.1] = 0.0
    return radiance, rng.uniform(5e-5, 3e-4, num_texels).astype(np.float32)


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("seed", [1, 2])
def test_equals_a_full_sort_bit_for_bit(ratio: float, seed: int, pool: BlockPool) -> None:
    radiance, area = _atlas(seed)
    expected = ratio_threshold_reference(radiance, area, ratio).astype(np.float32)
    np.testing.assert_array_equal(_threshold(radiance, area, ratio, pool), expected)


@pytest.mark.parametrize("ratio", RATIOS)
def test_holds_at_least_the_ratio_and_no_texel_too_many(ratio: float, pool: BlockPool) -> None:
    radiance, area = _atlas(3)
    threshold = _threshold(radiance, area, ratio, pool)
    direct, total = direct_totals(radiance, area, threshold)
    assert (direct >= ratio * total * (1.0 - 1e-12)).all()
    without_last, _ = direct_totals(radiance, area, np.nextafter(threshold, np.float32(np.inf)))
    assert (without_last < ratio * total).all()


def test_channels_are_independent(pool: BlockPool) -> None:
    radiance, area = _atlas(4)
    threshold = _threshold(radiance, area, 0.8, pool)
    changed = radiance.copy()
    changed[:, 1] *= 7.0
    other = _threshold(changed, area, 0.8, pool)
    assert threshold[0] == other[0]
    assert threshold[2] == other[2]
    assert other[1] == pytest.approx(7.0 * threshold[1], rel=1e-6)


def test_threads_do_not_matter() -> None:
    radiance, area = _atlas(5)
    pools = [BlockPool(count) for count in (1, 2, 3)]
    results = [_threshold(radiance, area, 0.9, pool) for pool in pools]
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])


def test_order_of_texels_does_not_matter(pool: BlockPool) -> None:
    radiance, area = _atlas(6)
    order = np.random.default_rng(0).permutation(area.size)
    np.testing.assert_array_equal(
        _threshold(radiance, area, 0.77, pool), _threshold(radiance[order], area[order], 0.77, pool)
    )


@pytest.mark.parametrize("factor", [2.0**-20, 2.0**-8, 2.0**6])
def test_scales_with_the_light(factor: float, pool: BlockPool) -> None:
    radiance, area = _atlas(7, decades=4.0)
    scaled = (radiance * np.float32(factor)).astype(np.float32)
    np.testing.assert_array_equal(
        _threshold(scaled, area, 0.9, pool), _threshold(radiance, area, 0.9, pool) * np.float32(factor)
    )


@pytest.mark.parametrize("ratio", [0.0, -0.1, 1.1, float("nan")])
def test_refuses_other_ratios(ratio: float, pool: BlockPool) -> None:
    radiance, area = _atlas(8, 10)
    with pytest.raises(ValueError, match=r"\(0, 1\]"):
        _threshold(radiance, area, ratio, pool)
