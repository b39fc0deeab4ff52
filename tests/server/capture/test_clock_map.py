"""The relation of two clocks from jittering arrivals: against truth that is known, and a linear program in float64."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from nearfield_server.capture.clock_map import (
    ClockMap,
    append_to_hull,
    shared_clock_offset,
    supporting_line,
)

DELAY_S = 0.003
FRAME_S = 1 / 30


def _pictures(
    rng: np.random.Generator,
    duration_s: float,
    *,
    skew: float = 0.0,
    jitter_s: float = 0.004,
    spikes: float = 0.02,
    frame_s: float = FRAME_S,
    start_s: float = 12345.678,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True times, stamps of the device, and arrivals in order, all in seconds; the host gains `skew` on the device."""
    true = start_s + np.arange(0.0, duration_s, frame_s)
    device = (true - start_s) / (1.0 + skew)
    delay = DELAY_S + rng.exponential(jitter_s, true.size)
    delay[rng.random(true.size) < spikes] += rng.uniform(0.05, 0.3)
    return true, device, np.maximum.accumulate(true + delay)


def _feed(clock: ClockMap, device: Iterable[float], arrival: Iterable[float]) -> Iterator[float]:
    """Host times in seconds."""
    for device_s, arrival_s in zip(device, arrival, strict=True):
        yield clock.observe(round(device_s * 1e9), round(arrival_s * 1e9)) * 1e-9


@pytest.mark.parametrize(("skew", "seed"), [(0.0, 1), (5e-5, 2), (-8e-5, 3), (4e-4, 4)])
def test_after_a_minute_times_are_good_to_hundredths_of_a_millisecond_and_rates_to_one_ppm(
    skew: float, seed: int
) -> None:
    true, device, arrival = _pictures(np.random.default_rng(seed), 150.0, skew=skew)
    clock = ClockMap()
    found = np.array(list(_feed(clock, device, arrival)))
    errors = (found - true - DELAY_S)[true - true[0] > 60.0]
    assert errors.std() < 3e-5
    assert abs(errors.mean()) < 1e-4
    assert abs(clock.skew_ppm - 1e6 * skew) < 1.0
    assert (arrival - true).std() > 20 * errors.std()
    assert (clock.jumps, clock.wraps) == (0, 0)


def test_the_first_seconds_are_no_worse_than_the_arrivals() -> None:
    true, device, arrival = _pictures(np.random.default_rng(5), 10.0, skew=1e-4)
    found = np.array(list(_feed(ClockMap(), device, arrival)))
    assert (found <= arrival + 1e-9).all()
    assert np.abs(found - true - DELAY_S)[true - true[0] > 2.0].max() < 2e-3


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.floats(1e-3, 2.0), st.floats(0.0, 0.02)), min_size=2, max_size=60),
    st.floats(1e-4, 1e-2),
)
def test_the_line_is_the_solution_of_the_linear_program(
    steps: list[tuple[float, float]], limit: float
) -> None:
    x = np.cumsum([step for step, _ in steps])
    y = np.array([height for _, height in steps])
    hull: list[tuple[float, float]] = []
    for point in zip(x.tolist(), y.tolist(), strict=True):
        append_to_hull(hull, point)
    slope, height = supporting_line(hull, float(x.mean()), -limit, limit)
    assert (height + slope * x <= y + 1e-12).all()
    oracle = linprog(
        [-x.mean(), -1.0],
        A_ub=np.stack([x, np.ones_like(x)], axis=1),
        b_ub=y,
        bounds=[(-limit, limit), (None, None)],
    )
    assert height + slope * x.mean() == pytest.approx(-oracle.fun, abs=5e-7)  # its own tolerance is 1e-7


def test_the_window_of_blocks_gives_the_program_over_its_points() -> None:
    """The hull of hulls is the hull: after the window has slid, the fit is that over the points that it holds."""
    _, device, arrival = _pictures(np.random.default_rng(6), 40.0, skew=2e-5)
    window_s = 12.0
    clock = ClockMap(window_s)
    found = list(_feed(clock, device, arrival))
    inside = device >= device[-1] - clock.span_s - 1e-6
    assert window_s <= clock.span_s <= window_s + 2 * window_s / 12
    x = device[inside] - device[inside][0]
    y = (arrival - device)[inside] - (arrival - device)[inside].min()
    oracle = linprog(
        [-x.mean(), -1.0],
        A_ub=np.stack([x, np.ones_like(x)], axis=1),
        b_ub=y,
        bounds=[(-1e-3, 1e-3), (None, None)],
    )
    at_end = device[-1] + (arrival - device)[inside].min() + oracle.x[0] * x[-1] + oracle.x[1]
    assert found[-1] == pytest.approx(at_end, abs=2e-7)
    assert clock.skew_ppm == pytest.approx(1e6 * oracle.x[0], abs=0.05)


@pytest.mark.parametrize("jump_s", [-3600.0, -7.0, -0.4, -0.02, 0.02, 0.5, 86400.0])
def test_a_clock_that_was_set_is_noticed_and_counted_once(jump_s: float) -> None:
    true, device, arrival = _pictures(np.random.default_rng(7), 60.0, skew=3e-5, spikes=0.0)
    device = np.where(true - true[0] >= 30.0, device + jump_s, device)
    clock = ClockMap()
    found = np.array(list(_feed(clock, device, arrival)))
    assert clock.jumps == 1
    assert clock.wraps == 0
    assert (found <= arrival + 1e-9).all()
    late = true - true[0] > 33.0
    assert np.abs(found - true - DELAY_S)[late].max() < 1e-3
    assert np.abs(found - true - DELAY_S)[-100:].max() < 2e-4
    assert abs(clock.skew_ppm - 30.0) < 15.0


@pytest.mark.parametrize("tick_ns", [1, 8, 1000])
def test_counters_of_32_bits_run_over_without_a_trace(tick_ns: int) -> None:
    true, device, arrival = _pictures(np.random.default_rng(8), 40.0, skew=-2e-5)
    wrap_s = (tick_ns << 32) * 1e-9
    stamps = (device + wrap_s - 5.5) % wrap_s
    clock = ClockMap()
    found = np.array(list(_feed(clock, stamps, arrival)))
    expected = int(np.count_nonzero(np.diff(stamps) < 0))
    assert (clock.wraps, clock.jumps) == (expected, 0)
    assert expected >= 1
    assert np.abs(found - true - DELAY_S)[true - true[0] > 3.0].max() < 2e-3


def test_several_wraps_in_a_silence() -> None:
    true, device, arrival = _pictures(np.random.default_rng(9), 60.0, spikes=0.0)
    heard = (true - true[0] < 20.0) | (true - true[0] > 35.0)
    wrap_s = 2**32 * 1e-9
    clock = ClockMap()
    found = np.array(list(_feed(clock, (device % wrap_s)[heard], arrival[heard])))
    assert clock.jumps == 0
    assert np.abs(found - true[heard] - DELAY_S)[-30:].max() < 2e-3


def test_a_restarted_device_keeps_its_rate() -> None:
    rng = np.random.default_rng(10)
    clock = ClockMap()
    _, device, arrival = _pictures(rng, 60.0, skew=7e-5)
    for _ in _feed(clock, device, arrival):
        pass
    clock.restart()
    true, device, arrival = _pictures(rng, 5.0, skew=7e-5, start_s=99999.0)
    found = np.array(list(_feed(clock, device, arrival)))
    assert clock.jumps == 0
    assert abs(clock.skew_ppm - 70.0) < 21.0
    assert np.abs(found - true - DELAY_S)[true - true[0] > 2.0].max() < 5e-4


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.integers(-(10**10), 10**10), st.integers(0, 10**9)), min_size=1, max_size=80))
def test_whatever_comes_no_picture_is_dated_after_its_arrival(steps: list[tuple[int, int]]) -> None:
    clock, device_ns, arrival_ns = ClockMap(), 10**9, 10**12
    for device_step, arrival_step in steps:
        device_ns, arrival_ns = max(0, device_ns + device_step), arrival_ns + arrival_step
        assert clock.observe(device_ns, arrival_ns) <= arrival_ns


def test_times_of_years_lose_no_nanoseconds() -> None:
    clock, years = ClockMap(), 30 * 365 * 86400 * 10**9
    for index in range(100):
        stamp = years + index * 33_333_333
        assert clock.observe(stamp, stamp - years + 5 * 10**9 + 7) == stamp - years + 5 * 10**9 + 7


def test_a_device_on_the_time_of_this_machine_needs_no_fit() -> None:
    clocks = {time.CLOCK_REALTIME: 1_700_000_000 * 10**9, time.CLOCK_TAI: 1_700_000_037 * 10**9}
    now = 5 * 10**9

    def offset(device_ns: int, arrival_ns: int) -> int | None:
        return shared_clock_offset(
            device_ns, arrival_ns, monotonic_ns=lambda: now, read_clock=clocks.__getitem__
        )

    for clock in clocks.values():
        found = offset(clock - 20_000_000, now)
        assert found is not None
        assert clock - 20_000_000 + found == now - 20_000_000
    # Another grandmaster, or a picture that would come from the future.
    assert offset(0, now) is None
    assert offset(clocks[time.CLOCK_REALTIME] + 2_000_000, now) is None
