"""The choice of exposures: it settles within a few pictures, stays settled, and what it settles on shows the scene."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.errors import ConfigError
from nearfield_server.imaging.bracket_plan import (
    MOST_RATIO,
    BracketLimits,
    BracketPlan,
    RadianceHistogram,
    first_bracket,
    plan_bracket,
    radiance_histogram,
)

BOUND = np.nextafter(np.float16(1), np.float16(0))
FULL = 2.0
"""Radiance that fills the range at an amount of 1."""


def _picture(radiance: np.ndarray, plan: BracketPlan, rng: np.random.Generator) -> np.ndarray:
    """What a merge of the bracket gives: bounds above the shortest exposure, read and photon noise, no negative values."""
    longest, shortest = max(plan.amounts), min(plan.amounts)
    out = np.ones((*radiance.shape, 4), np.float16)
    best = np.max([np.where(radiance * amount <= 0.98 * FULL, amount, 0) for amount in plan.amounts], axis=0)
    amount = np.where(best > 0, best, shortest)
    electrons = radiance * amount / FULL * 10_000
    noisy = electrons + np.sqrt(electrons + 9) * rng.standard_normal(radiance.shape)
    value = np.where(best > 0, noisy / 10_000 / amount * FULL, 0.98 * FULL / shortest)
    out[..., :3] = np.clip(value, 0, 65504)[..., None]
    out[best == 0, 3] = BOUND
    assert longest >= shortest
    return out


def _scene(rng: np.random.Generator, darkest: float, span: float) -> np.ndarray:
    """(60, 60): 98 % of a room, log-uniform over the lower part of the span, and a lamp at its top."""
    radiance = darkest * span ** (0.6 * rng.random((60, 60)))
    radiance[10:18, 10:19] = darkest * span
    return radiance


@given(
    span=st.floats(1.5, 1e6),
    # Together with the span: everything that half floats and a shutter from 10 us to 1 s can show, and beyond.
    log_darkest=st.floats(-3.0, 1.0),
    num_exposures=st.integers(2, 6),
    seed=st.integers(0, 2**32),
    start=st.one_of(st.none(), st.floats(-5, 0)),
)
def test_it_settles_within_a_few_pictures_and_then_does_not_hunt(
    span: float, log_darkest: float, num_exposures: int, seed: int, start: float | None
) -> None:
    rng = np.random.default_rng(seed)
    scene = np.minimum(_scene(rng, 10.0**log_darkest, span), 60_000.0)
    limits = BracketLimits(shortest=1e-5, longest=1.0, num_exposures=num_exposures, full_radiance=FULL)
    plan = first_bracket(limits)
    if start is not None:  # after any other scene
        ends = np.clip([10.0**start, 10.0 ** (start - 2)], limits.shortest, limits.longest)
        plan = BracketPlan(amounts=tuple(np.geomspace(*ends, num_exposures).tolist()))
    plans = [plan]
    for _ in range(40):
        plans.append(plan_bracket(radiance_histogram(_picture(scene, plans[-1], rng)), plans[-1], limits))
    changes = [k for k in range(40) if plans[k + 1].amounts != plans[k].amounts]
    assert len(changes) <= 6
    # A start that lies on the very edge of good enough may be given up late, whenever noise says so, but once only.
    assert len([k for k in changes if k >= 18]) <= 1
    settled = plans[-1].amounts
    assert limits.shortest * 0.999 <= min(settled)
    assert max(settled) <= limits.longest * 1.001
    # The brightest is measured, or nothing shorter is allowed; the darkest percentile is well exposed, or nothing longer is.
    assert min(settled) * scene.max() <= 0.98 * FULL or min(settled) <= limits.shortest * 1.06
    dark = np.quantile(scene, 0.01) * max(settled) / FULL
    widest = min(settled) * MOST_RATIO ** (num_exposures - 1)
    assert dark >= 0.007 or max(settled) >= 0.94 * min(limits.longest, widest)
    assert np.all(np.divide(settled[:-1], settled[1:]) < 1.01 * MOST_RATIO)


def test_a_blinded_camera_finds_its_exposure_in_a_few_pictures() -> None:
    rng = np.random.default_rng(0)
    limits = BracketLimits(shortest=1e-6, longest=1.0, num_exposures=3)
    plan = BracketPlan(amounts=(1.0, 0.5, 0.25))
    for _ in range(4):
        plan = plan_bracket(radiance_histogram(_picture(np.full((30, 30), 5e4), plan, rng)), plan, limits)
    assert min(plan.amounts) * 5e4 < FULL


def test_a_passing_shadow_changes_nothing_but_a_lamp_does_at_once() -> None:
    rng = np.random.default_rng(1)
    limits = BracketLimits(shortest=1e-5, longest=10.0, num_exposures=3, full_radiance=FULL)
    room = np.full((50, 50), 1.0)
    room[:5, :5] = 50.0
    plan = first_bracket(limits)
    for _ in range(15):
        plan = plan_bracket(radiance_histogram(_picture(room, plan, rng)), plan, limits)
    for _ in range(2):
        shadow = plan_bracket(radiance_histogram(_picture(room * 1e-3, plan, rng)), plan, limits)
        assert shadow.amounts == plan.amounts
    lit = plan_bracket(radiance_histogram(_picture(room * 100, plan, rng)), plan, limits)
    assert min(lit.amounts) < min(plan.amounts) / 3


def test_a_few_stuck_pixels_do_not_shorten_it() -> None:
    counts = np.zeros(512, np.int64)
    counts[int(np.float16(1.0).view(np.uint16)) >> 6] = 10**6
    limits = BracketLimits(shortest=1e-5, longest=1.0, num_exposures=2)
    plan = BracketPlan(amounts=(0.5, 0.25))
    assert plan_bracket(RadianceHistogram(counts=counts, num_bounds=20), plan, limits).amounts == (0.5, 0.25)
    assert min(plan_bracket(RadianceHistogram(counts=counts, num_bounds=200), plan, limits).amounts) < 0.1


def test_the_histogram_counts_each_pixel_once_by_its_brightest_channel() -> None:
    rng = np.random.default_rng(2)
    pixels = np.ones((40, 50, 4), np.float16)
    pixels[..., :3] = 10.0 ** rng.uniform(-4, 4, (40, 50, 3))
    pixels[..., 3] = rng.choice([1.0, BOUND, 0.0], (40, 50))
    circle = rng.random((40, 50)) < 0.7
    found = radiance_histogram(pixels, circle)
    measured = circle & (pixels[..., 3] == 1)
    assert found.num_bounds == (circle & (pixels[..., 3] == BOUND)).sum()
    assert found.num_pixels - found.num_bounds == measured.sum()
    largest = pixels[measured, :3].max(-1).astype(float)
    assert largest.max() <= found.brightest <= largest.max() * 2 ** (1 / 8)
    median = np.quantile(np.append(largest, [np.inf] * found.num_bounds), 0.5)
    assert found.quantile(0.5) == pytest.approx(median, rel=0.1)


def test_nothing_visible_keeps_the_plan() -> None:
    limits, plan = BracketLimits(shortest=0.1, longest=1, num_exposures=2), BracketPlan(amounts=(0.5, 0.25))
    empty = radiance_histogram(np.zeros((4, 4, 4), np.float16))
    assert plan_bracket(empty, plan, limits).amounts == plan.amounts
    assert empty.quantile(0.5) == empty.brightest == 0.0


def test_impossible_limits_are_refused() -> None:
    for shortest, longest, count in ((1.0, 0.5, 3), (0.0, 1.0, 3), (0.1, 1.0, 1)):
        with pytest.raises(ConfigError, match="0 < shortest < longest"):
            BracketLimits(shortest=shortest, longest=longest, num_exposures=count)
