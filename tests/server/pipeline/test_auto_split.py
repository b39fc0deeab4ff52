import numpy as np
import pytest

from nearfield_server.pipeline.auto_split import AutoSplit, ReflectionTest, auto_threshold
from nearfield_server.pipeline.blocks import BlockPool
from nearfield_server.pipeline.split import fixed_point_scale, radiance_histogram


def _auto(
    radiance: np.ndarray, area: np.ndarray, pool: BlockPool, previous: np.ndarray | None = None
) -> np.ndarray:
    total_area = float(area.sum(dtype=np.float64))
    scale = fixed_point_scale(float(radiance.max(initial=0.0)), total_area)
    histogram = radiance_histogram(radiance, area, scale, -(-area.size // 64), pool)
    return auto_threshold(histogram, scale, total_area, previous)


def _room(lamps: list[tuple[float, float]], seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Walls that shade smoothly over a decade, and lamps (radiance, share of the area). Returns also the lamp number."""
    rng = np.random.default_rng(seed)
    count = 20000
    lamp = np.full(count, -1)
    radiance = np.exp(rng.normal(0.0, 0.5, count)).clip(0.2, 4.0)
    start = 0
    for index, (value, share) in enumerate(lamps):
        members = slice(start, start + int(share * count))
        lamp[members] = index
        radiance[members] = value
        start = members.stop
    return (
        np.repeat(radiance[:, None], 3, axis=1).astype(np.float32),
        np.full(count, 1e-3, dtype=np.float32),
        lamp,
    )


@pytest.mark.parametrize(
    "lamps",
    [[(50.0, 0.005)], [(50.0, 0.005), (12.0, 0.02)], [(3000.0, 0.0002), (100.0, 0.003), (15.0, 0.03)]],
)
def test_lamps_are_direct_and_walls_are_not(lamps: list[tuple[float, float]], pool: BlockPool) -> None:
    radiance, area, lamp = _room(lamps)
    direct = radiance >= _auto(radiance, area, pool)
    np.testing.assert_array_equal(direct, np.repeat((lamp >= 0)[:, None], 3, axis=1))


def test_a_room_without_a_source_has_no_direct_light(pool: BlockPool) -> None:
    radiance, area, _ = _room([])
    assert np.isinf(_auto(radiance, area, pool)).all()


def test_a_luminous_ceiling_stays_indirect(pool: BlockPool) -> None:
    radiance, area, _ = _room([(30.0, 0.2)])
    assert np.isinf(_auto(radiance, area, pool)).all()


def test_a_lamp_in_a_black_room_is_direct(pool: BlockPool) -> None:
    radiance = np.zeros((5000, 3), dtype=np.float32)
    radiance[100:110] = 5.0
    threshold = _auto(radiance, np.full(5000, 1e-3, dtype=np.float32), pool)
    assert ((threshold > 0.0) & (threshold <= 5.0)).all()


@pytest.mark.parametrize("value", [0.0, 1.0, 65504.0, 1e-7])
def test_one_radiance_everywhere_is_indirect(value: float, pool: BlockPool) -> None:
    for count in (1, 1000):
        radiance = np.full((count, 3), value, dtype=np.float32)
        assert np.isinf(_auto(radiance, np.full(count, 1e-3, dtype=np.float32), pool)).all()


def test_channels_are_judged_one_by_one(pool: BlockPool) -> None:
    radiance, area, lamp = _room([(50.0, 0.005)])
    radiance[lamp == 0, 1:] = 1.0  # a red lamp
    threshold = _auto(radiance, area, pool)
    assert np.isfinite(threshold[0])
    assert np.isinf(threshold[1:]).all()


def test_scales_with_the_light(pool: BlockPool) -> None:
    radiance, area, _ = _room([(50.0, 0.005)])
    threshold = _auto(radiance, area, pool)
    np.testing.assert_array_equal(
        _auto(radiance * np.float32(2.0**-10), area, pool), threshold * np.float32(2.0**-10)
    )


def test_noise_moves_nothing(pool: BlockPool) -> None:
    radiance, area, _ = _room([(50.0, 0.005), (9.0, 0.03)])
    threshold = _auto(radiance, area, pool)
    direct = radiance >= threshold
    rng = np.random.default_rng(2)
    for _ in range(20):
        noisy = (radiance * rng.normal(1.0, 0.01, radiance.shape)).astype(np.float32)
        found = _auto(noisy, area, pool, threshold)
        np.testing.assert_array_equal(found, threshold)
        np.testing.assert_array_equal(noisy >= found, direct)


def test_a_new_dimmer_lamp_lowers_the_threshold(pool: BlockPool) -> None:
    before, area, _ = _room([(80.0, 0.005)])
    previous = _auto(before, area, pool)
    after, _, lamp = _room([(80.0, 0.005), (12.0, 0.02)])
    direct = after[:, 0] >= _auto(after, area, pool, previous)[0]
    np.testing.assert_array_equal(direct, lamp >= 0)


def _choose(
    split: AutoSplit,
    radiance: np.ndarray,
    area: np.ndarray,
    pool: BlockPool,
    is_reflected: ReflectionTest | None = None,
) -> np.ndarray:
    total_area = float(area.sum(dtype=np.float64))
    scale = fixed_point_scale(float(radiance.max(initial=0.0)), total_area)
    histogram = radiance_histogram(radiance, area, scale, -(-area.size // 64), pool)
    return split.choose(histogram, scale, total_area, is_reflected)


def test_the_way_back_leads_to_the_same_threshold(pool: BlockPool) -> None:
    """With the strong lamp off a lower cut is right; with the lamp on it would lie among the surfaces that it lights."""
    dim, area, lamp = _room([(4.0, 0.02), (60.0, 0.01)])
    bright = dim.copy()
    dim[lamp == 1] = 0.2
    dim[lamp < 0] *= 0.2
    split = AutoSplit()
    first = _choose(split, bright, area, pool)
    assert (_choose(split, dim, area, pool) < first).all()
    np.testing.assert_array_equal(_choose(split, bright, area, pool), first)


def test_noise_never_makes_the_split_choose_anew(pool: BlockPool) -> None:
    radiance, area, _ = _room([(50.0, 0.005), (12.0, 0.02)])
    rng = np.random.default_rng(4)
    split = AutoSplit()
    first = _choose(split, radiance, area, pool)
    for _ in range(20):
        noisy = (radiance * (1.0 + 0.01 * rng.normal(size=radiance.shape))).astype(np.float32)
        np.testing.assert_array_equal(_choose(split, noisy, area, pool), first)


def test_switching_off_forgets_the_threshold(pool: BlockPool) -> None:
    before, area, _ = _room([(80.0, 0.005)])
    previous = _auto(before, area, pool)
    assert np.isinf(_auto(_room([])[0], area, pool, previous)).all()


def test_the_lowest_class_is_left_out_when_it_only_reflects(pool: BlockPool) -> None:
    radiance, area, lamp = _room([(60.0, 0.005), (12.0, 0.02)])
    questions = []

    def reflects(channel: int, upper: float, lower: float, energy: float, area_above: float) -> bool:
        questions.append(channel)
        assert 12.0 < upper <= 60.0
        assert 4.0 < lower <= 12.0
        assert energy == pytest.approx(60.0 * 0.005 * area.sum(), rel=1e-3)
        # The histogram knows radiance to the width of a level.
        assert area_above == pytest.approx(0.005 * area.sum(), rel=0.05)
        return True

    direct = radiance >= _choose(AutoSplit(), radiance, area, pool, reflects)
    np.testing.assert_array_equal(direct, np.repeat((lamp == 0)[:, None], 3, axis=1))
    assert questions == [0, 1, 2]


def test_a_class_between_two_sources_stays(pool: BlockPool) -> None:
    """One threshold cannot leave it out without losing the dimmer source."""
    radiance, area, lamp = _room([(1000.0, 0.001), (100.0, 0.01), (14.0, 0.03)])
    threshold = _choose(AutoSplit(), radiance, area, pool, lambda _, upper, *rest: upper > 100.0)
    np.testing.assert_array_equal(radiance[:, 0] >= threshold[0], lamp >= 0)


def test_the_brightest_class_is_a_source_whatever_the_test_says(pool: BlockPool) -> None:
    radiance, area, lamp = _room([(50.0, 0.005)])
    threshold = _choose(AutoSplit(), radiance, area, pool, lambda *_: True)
    np.testing.assert_array_equal(radiance[:, 0] >= threshold[0], lamp == 0)


def test_a_refused_class_is_asked_about_once_per_light(pool: BlockPool) -> None:
    radiance, area, _ = _room([(60.0, 0.005), (12.0, 0.02)])
    questions = []

    def reflects(channel: int, *_: float) -> bool:
        questions.append(channel)
        return True

    split, rng = AutoSplit(), np.random.default_rng(5)
    first = _choose(split, radiance, area, pool, reflects)
    for _ in range(10):
        noisy = (radiance * (1.0 + 0.01 * rng.normal(size=radiance.shape))).astype(np.float32)
        np.testing.assert_array_equal(_choose(split, noisy, area, pool, reflects), first)
    assert len(questions) == 3
    _choose(split, radiance * np.float32(2.0), area, pool, reflects)
    assert len(questions) == 6


def test_a_believed_class_is_asked_about_once_per_light(pool: BlockPool) -> None:
    radiance, area, lamp = _room([(60.0, 0.005), (12.0, 0.02)])
    questions = []

    def is_source(*question: float) -> bool:
        questions.append(question[0])
        return False

    split, rng = AutoSplit(), np.random.default_rng(6)
    for _ in range(5):
        noisy = (radiance * (1.0 + 0.01 * rng.normal(size=radiance.shape))).astype(np.float32)
        threshold = _choose(split, noisy, area, pool, is_source)
        np.testing.assert_array_equal(radiance[:, 0] >= threshold[0], lamp >= 0)
    assert questions == [0, 1, 2]
    _choose(split, radiance * np.float32(0.5), area, pool, is_source)
    assert questions == [0, 1, 2, 0, 1, 2]
