"""Brackets of a scripted camera: every method, and faults that must never give a picture a wrong exposure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nearfield_server.capture.bracketing import Bracket, Bracketing, find_shift
from nearfield_server.capture.device import DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.capture.exposure_methods import choose_method, nearest_exposure

EXPOSURES = tuple(Exposure(time_s=time_s) for time_s in (0.08, 0.02, 0.005, 0.00125))
RNG = np.random.default_rng(1)
SCENE = np.exp(RNG.uniform(np.log(0.3), np.log(300.0), (24, 32)))
RANGE_S = (1e-5, 1.0)
SEQUENCER = DeviceCapabilities(
    exposure_range_s=RANGE_S, sequencer=True, labels_exposure=True, device_clock=True
)
TRIGGER = DeviceCapabilities(exposure_range_s=RANGE_S, software_trigger=True, device_clock=True)
FREE = DeviceCapabilities(exposure_range_s=RANGE_S, settle_frames=2, device_clock=True)
METHODS = {"sequencer": SEQUENCER, "software_trigger": TRIGGER, "free_running": FREE}


class Rig:
    """A bracketing with planes of codes, and the truth about every picture."""

    def __init__(self, device: Any, clock: Callable[[], int], **options: Any) -> None:
        self.device, self.clock = device, clock
        self.planes: dict[int, np.ndarray] = {}
        self.capabilities = device.open()
        self.bracketing = Bracketing(
            device, self.capabilities, store=self.store, ratios=self.ratios, clock=clock, **options
        )

    def store(self, index: int, frame: SensorFrame) -> tuple[int, int]:
        self.planes[index] = frame.data.view("<u2").astype(np.float64)
        start_ns = self.device.start_ns[frame.frame_id]
        return start_ns, start_ns + round(self.device.truth[frame.frame_id].time_s * 1e9)

    def ratios(self) -> Sequence[tuple[int, int, float]]:
        """Sums over pixels that are well exposed in both."""
        found = []
        for first in range(len(self.planes) - 1):
            left, right = self.planes[first], self.planes[first + 1]
            both = (left < 4000) & (right < 4000) & (left + right > 60)
            ratio = left[both].sum() / max(right[both].sum(), 1e-9) if both.sum() > 20 else math.nan
            found.append((first, first + 1, float(ratio)))
        return found

    def run(self, seconds: float) -> list[Bracket]:
        end_ns = self.clock() + round(seconds * 1e9)
        brackets = []
        while self.clock() < end_ns:
            before_ns = self.clock()
            bracket = self.bracketing.step(0.05)
            assert self.clock() - before_ns <= 60_000_000  # the loop stays responsive
            assert not self.device.lent
            if bracket is not None:
                brackets.append(bracket)
        return brackets

    def assert_true(self, brackets: Sequence[Bracket]) -> None:
        """Every picture is said to have the exposure that it had."""
        for bracket in brackets:
            truth = [self.device.truth[frame_id] for frame_id in bracket.frame_ids]
            assert [each.amount for each in bracket.exposures] == pytest.approx(
                [each.amount for each in truth]
            )
            starts = [self.device.start_ns[frame_id] for frame_id in bracket.frame_ids]
            assert bracket.start_ns == min(starts)
            assert bracket.start_ns < bracket.middle_ns < bracket.end_ns


def test_the_fastest_method_that_the_camera_can_do_is_chosen() -> None:
    assert choose_method("auto", SEQUENCER) == "sequencer"
    assert choose_method("auto", TRIGGER) == "software_trigger"
    assert choose_method("auto", FREE) == "free_running"
    assert choose_method("free_running", SEQUENCER) == "free_running"
    assert choose_method("sequencer", TRIGGER) == "software_trigger"
    unlabelled = DeviceCapabilities(exposure_range_s=RANGE_S, sequencer=True)
    assert choose_method("auto", unlabelled) == "free_running"


def test_labels_are_those_of_the_plan_within_the_rounding_of_devices() -> None:
    assert nearest_exposure(EXPOSURES, Exposure(time_s=0.0201)) == 1
    assert nearest_exposure(EXPOSURES, Exposure(time_s=0.01, gain=2.0)) == 1
    assert nearest_exposure(EXPOSURES, Exposure(time_s=0.03)) is None


@pytest.mark.parametrize("method", METHODS)
def test_every_method_takes_whole_brackets_with_true_exposures(
    method: str, make_device: Callable[..., Any], clock: Any
) -> None:
    device = make_device(SCENE, capabilities=METHODS[method], label_lag=0 if method == "sequencer" else -1)
    rig = Rig(device, clock)
    assert rig.bracketing.method.name == method
    rig.bracketing.start(EXPOSURES)
    brackets = rig.run(20.0)
    rig.assert_true(brackets)
    counters = rig.bracketing.counters
    # A picture from before the plan may have one of its exposures.
    assert counters.broken <= 1
    assert (counters.inconsistent, counters.unverified) == (0, 0)
    assert counters.complete == len(brackets)
    # Sequencer: four pictures at 10 Hz; free running: three of them per exposure; trigger: as fast as exposure and transfer go.
    expected = {"sequencer": 50, "software_trigger": 20.0 / (0.10625 + 4 * 0.01), "free_running": 20.0 / 1.2}
    assert len(brackets) == pytest.approx(expected[method], rel=0.1)
    assert rig.bracketing.warnings == []


@pytest.mark.parametrize("method", METHODS)
def test_exposures_are_those_that_the_device_made_of_them(
    method: str, make_device: Callable[..., Any], clock: Any
) -> None:
    labelled = 0 if method == "sequencer" else -1
    rig = Rig(make_device(SCENE, capabilities=METHODS[method], label_lag=labelled, rounding_s=7e-4), clock)
    rig.bracketing.start(EXPOSURES)
    brackets = rig.run(5.0)
    rig.assert_true(brackets)
    assert brackets[0].exposures[3].time_s == pytest.approx(0.0014)
    assert "0.00125 s at gain 1 was asked for, the camera exposes 0.0014 s" in rig.bracketing.warnings[0]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", [1, 2])
def test_lost_pictures_cost_brackets_but_never_their_truth(
    method: str, seed: int, make_device: Callable[..., Any], clock: Any
) -> None:
    rng = np.random.default_rng(seed)
    labelled = 0 if method == "sequencer" else -1
    device = make_device(
        SCENE, capabilities=METHODS[method], label_lag=labelled, lost=lambda _id: rng.random() < 0.15
    )
    rig = Rig(device, clock)
    rig.bracketing.start(EXPOSURES)
    brackets = rig.run(40.0)
    assert len(brackets) > 8
    assert device.lost_ids
    rig.assert_true(brackets)
    assert not any(set(bracket.frame_ids) & set(device.lost_ids) for bracket in brackets)
    if method == "sequencer":
        assert rig.bracketing.counters.broken > 0
        assert all(max(each.frame_ids) - min(each.frame_ids) == 3 for each in brackets)


def test_a_trigger_that_is_never_answered_is_given_up(make_device: Callable[..., Any], clock: Any) -> None:
    start_s = clock() * 1e-9
    device = make_device(SCENE, capabilities=TRIGGER, silent=lambda time_s: 1.0 < time_s - start_s < 6.0)
    rig = Rig(device, clock)
    rig.bracketing.start(EXPOSURES)
    brackets = rig.run(10.0)
    rig.assert_true(brackets)
    assert max(bracket.end_ns - bracket.start_ns for bracket in brackets) < 0.2e9
    assert clock() - brackets[-1].end_ns < 1e9
    # Asked again, but not in a frenzy: each answer is waited for a quarter of a second longer than its exposure.
    assert device.triggers <= 4 * len(brackets) + 4 + 5.0 / 0.25


@pytest.mark.parametrize("lag", [1, 2])
def test_labels_that_are_late_are_noticed_and_corrected(
    lag: int, make_device: Callable[..., Any], clock: Any
) -> None:
    rig = Rig(make_device(SCENE, capabilities=SEQUENCER, label_lag=lag), clock)
    rig.bracketing.start(EXPOSURES)
    brackets = rig.run(10.0)
    rig.assert_true(brackets)
    assert len(brackets) >= 15
    assert rig.bracketing.counters.inconsistent == 3
    assert f"{lag} picture" in rig.bracketing.warnings[0]


def test_settings_that_a_triggered_sensor_applies_late_are_corrected(
    make_device: Callable[..., Any], clock: Any
) -> None:
    rig = Rig(make_device(SCENE, capabilities=TRIGGER, trigger_lag=1), clock)
    rig.bracketing.start(EXPOSURES)
    brackets = rig.run(10.0)
    rig.assert_true(brackets)
    assert len(brackets) > 30


@pytest.mark.parametrize("brightness", [1.0, 1e-4])
def test_a_camera_that_exposes_long_after_the_trigger_is_not_hurried(
    brightness: float, make_device: Callable[..., Any], clock: Any
) -> None:
    """In the dark as well, where the pixels would not tell."""
    rig = Rig(make_device(SCENE * brightness, capabilities=TRIGGER, trigger_delay_s=0.04), clock)
    rig.bracketing.start(EXPOSURES)
    brackets = rig.run(10.0)
    rig.assert_true(brackets)
    assert len(brackets) > 25
    assert rig.bracketing.counters.inconsistent == 0
    assert rig.bracketing.counters.unverified == (len(brackets) if brightness < 1.0 else 0)


@pytest.mark.parametrize("effect", [3, 4, 5])
def test_a_sensor_that_is_slower_than_its_settle_frames_gets_more_of_them(
    effect: int, make_device: Callable[..., Any], clock: Any
) -> None:
    rig = Rig(make_device(SCENE, capabilities=FREE, effect_frames=effect), clock)
    rig.bracketing.start(EXPOSURES)
    brackets = rig.run(60.0)
    rig.assert_true(brackets)
    assert len(brackets) > 5
    assert "are now dropped after each change" in rig.bracketing.warnings[0]


@pytest.mark.parametrize("method", METHODS)
def test_light_that_changes_within_a_bracket_drops_it(
    method: str, make_device: Callable[..., Any], clock: Any
) -> None:
    """A lamp is switched every 1.7 s: no bracket mixes both states."""
    start_s = clock() * 1e-9

    def state(time_s: float) -> int:
        return int((time_s - start_s) / 1.7) % 2

    labelled = 0 if method == "sequencer" else -1
    device = make_device(
        lambda time_s: SCENE * (1.0 + state(time_s)),
        capabilities=METHODS[method],
        label_lag=labelled,
        period_s=0.05,
    )
    rig = Rig(device, clock)
    rig.bracketing.start(EXPOSURES)
    brackets = rig.run(60.0)
    assert len(brackets) > 20
    assert rig.bracketing.counters.inconsistent >= 10
    rig.assert_true(brackets)
    for bracket in brackets:
        totals = {float(device.shown[frame_id].sum()) for frame_id in bracket.frame_ids}
        assert len(totals) == 1


def test_light_that_never_holds_still_is_said_in_words(make_device: Callable[..., Any], clock: Any) -> None:
    device = make_device(
        lambda time_s: SCENE * (1.0 + 0.9 * math.sin(40.0 * time_s)), capabilities=SEQUENCER, label_lag=0
    )
    rig = Rig(device, clock)
    rig.bracketing.start(EXPOSURES)
    rig.run(20.0)
    assert "do not fit their exposures" in rig.bracketing.warnings[0]


def test_a_new_plan_leaves_no_picture_of_the_old_one(make_device: Callable[..., Any], clock: Any) -> None:
    for capabilities, labelled in ((SEQUENCER, 0), (TRIGGER, -1), (FREE, -1)):
        rig = Rig(make_device(SCENE, capabilities=capabilities, label_lag=labelled), clock)
        plans = [EXPOSURES, EXPOSURES[1:], tuple(reversed(EXPOSURES))]
        for plan in plans:
            rig.planes.clear()
            rig.bracketing.start(plan)
            brackets = rig.run(6.0)
            rig.assert_true(brackets)
            assert len(brackets) > 2
            assert all(len(bracket.exposures) == len(plan) for bracket in brackets)


def test_a_method_beyond_the_camera_is_replaced_with_words(
    make_device: Callable[..., Any], clock: Any
) -> None:
    rig = Rig(make_device(SCENE, capabilities=FREE), clock, method="sequencer")
    assert rig.bracketing.method.name == "free_running"
    assert '"free_running" is used' in rig.bracketing.warnings[0]


def test_triggered_brackets_keep_to_their_period(make_device: Callable[..., Any], clock: Any) -> None:
    rig = Rig(make_device(SCENE, capabilities=TRIGGER), clock, period_s=0.5)
    rig.bracketing.start(EXPOSURES)
    brackets = rig.run(20.0)
    rig.assert_true(brackets)
    assert len(brackets) == pytest.approx(40, abs=1)


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.floats(math.log(2.0), math.log(16.0)), min_size=1, max_size=5),
    st.integers(0, 5),
    st.randoms(use_true_random=False),
)
def test_every_shift_of_every_plan_is_found(steps: list[float], shift: int, rng: Any) -> None:
    amounts = np.exp(np.concatenate([[0.0], np.cumsum(steps)]))
    count = len(amounts)
    shift %= count
    true = [amounts[(index - shift) % count] for index in range(count)]
    noise = [math.exp(rng.uniform(-0.05, 0.05)) for _ in range(count)]
    ratios = [
        (first, second, true[first] / true[second] * noise[first])
        for first in range(count)
        for second in range(first + 1, count)
    ]
    assert find_shift(amounts, ratios) == shift
    # A step that is wrong alone is no shift.
    wrong = [(i, j, r * 1.5 if i == 0 else r) for i, j, r in ratios]
    assert count == 2 or find_shift(amounts, wrong) is None or min(steps) < math.log(2.2)


def test_pictures_that_tell_nothing_leave_the_labels_as_they_are() -> None:
    assert find_shift([1.0, 4.0, 16.0], [(0, 1, math.nan), (1, 2, math.nan)]) == 0
    assert find_shift([1.0, 4.0, 16.0], [(0, 1, math.nan)], likely=2) == 2


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(sorted(METHODS)))
def test_random_faults_never_give_a_picture_a_wrong_exposure(seed: int, method: str) -> None:
    """Losses, late settings, lying labels, other programs, switched lamps, jitter: whatever is passed on is true."""
    from_conftest = _scripted()
    rng = np.random.default_rng(seed)
    clock = from_conftest.VirtualClock()
    start_s = clock() * 1e-9
    switches = np.sort(rng.uniform(0.0, 20.0, rng.integers(0, 6)))
    levels = rng.choice([0.3, 1.0, 3.0], 7)
    device = from_conftest.ScriptedDevice(
        clock,
        lambda time_s: SCENE * levels[np.searchsorted(switches, time_s - start_s)],
        capabilities=METHODS[method],
        period_s=rng.choice([0.03, 0.1]),
        jitter_s=rng.choice([0.0, 0.02]),
        effect_frames=int(rng.integers(0, 4)),
        trigger_lag=int(rng.integers(0, 2)),
        label_lag=int(rng.integers(0, 3)) if method == "sequencer" else -1,
        lost=lambda _id: rng.random() < 0.1,
    )
    rig = Rig(device, clock)
    rig.bracketing.start(EXPOSURES)
    for _ in range(20):
        brackets = rig.run(1.0)
        for bracket in brackets:
            truth = np.array([device.truth[frame_id].amount for frame_id in bracket.frame_ids])
            light = np.array([device.shown[frame_id].mean() for frame_id in bracket.frame_ids])
            said = np.array([each.amount for each in bracket.exposures])
            # One light for the whole bracket, up to what the tolerance lets pass.
            assert np.ptp(np.log(truth * light / said)) < 0.3
        if rng.random() < 0.1 and method != "sequencer":
            device.meddle(Exposure(time_s=float(rng.uniform(0.001, 0.1))))


def _scripted() -> Any:
    """The classes of the conftest, for tests that make many devices of their own."""
    import sys

    return next(module for name, module in sys.modules.items() if name.endswith("capture.conftest"))
