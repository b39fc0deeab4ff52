"""Statistics of interleaved rounds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.benchmark.ratios import fit_exponent, ratio_spread, spread

COSTS = st.lists(st.floats(1e-3, 1e6), min_size=1, max_size=30)


def test_quartiles_of_a_known_sample() -> None:
    result = spread([5.0, 1.0, 3.0, 2.0, 4.0])
    assert (result.lower_quartile, result.median, result.upper_quartile, result.count) == (2.0, 3.0, 4.0, 5)
    assert result.as_dict() == {"median": 3.0, "lower_quartile": 2.0, "upper_quartile": 4.0, "count": 5}


@given(COSTS, st.floats(0.1, 10.0), st.floats(1e-2, 1e2))
def test_a_slow_moment_of_the_machine_cancels(costs: list[float], ratio: float, factor: float) -> None:
    """Every round is slowed by its own factor; the ratio does not notice."""
    slowdown = factor * np.linspace(1.0, 7.0, len(costs))
    below = [cost * slow for cost, slow in zip(costs, slowdown, strict=True)]
    result = ratio_spread([ratio * cost for cost in below], below)
    assert result.median == pytest.approx(ratio)
    assert result.upper_quartile - result.lower_quartile <= 1e-9 * ratio


@given(COSTS)
def test_quartiles_enclose_the_median(costs: list[float]) -> None:
    result = spread(costs)
    assert min(costs) <= result.lower_quartile <= result.median <= result.upper_quartile <= max(costs)


def test_wrong_rounds_are_refused() -> None:
    with pytest.raises(ValueError, match="as many rounds"):
        ratio_spread([1.0], [1.0, 2.0])
    with pytest.raises(ValueError, match="positive"):
        ratio_spread([0.0], [1.0])
    with pytest.raises(ValueError, match="finite"):
        spread([])
    with pytest.raises(ValueError, match="finite"):
        spread([float("nan")])


@given(
    st.floats(-3.0, 3.0),
    st.floats(1e-3, 1e3),
    st.lists(st.floats(1.0, 1e6), min_size=2, unique=True, max_size=9),
)
def test_a_power_law_is_found_again(exponent: float, factor: float, sizes: list[float]) -> None:
    if np.ptp(np.log(sizes)) < 1e-3:
        return
    costs = [factor * size**exponent for size in sizes]
    assert fit_exponent(sizes, costs) == pytest.approx(exponent, abs=1e-6)


def test_no_exponent_without_growth() -> None:
    for sizes, costs in (
        ([1.0, 1.0], [1.0, 2.0]),
        ([1.0], [1.0]),
        ([1.0, 2.0], [0.0, 1.0]),
        ([1.0, 2.0], [1.0]),
    ):
        with pytest.raises(ValueError, match="different positive sizes"):
            fit_exponent(sizes, costs)
