"""Pictures with the time of this machine, counted, and a device that falls silent."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from nearfield_server.capture.device import DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.capture.frame_stream import (
    FIRST_FRAME_S,
    LEAST_FIRST_FRAME_S,
    FrameStream,
    silence_limit_s,
)
from nearfield_server.capture.picture_watch import FrozenWatch, exposure_differs
from nearfield_server.errors import CaptureError

SCENE = np.full((4, 8), 20.0)


def _take(
    stream: FrameStream, clock: Callable[[], int], seconds: float
) -> list[tuple[SensorFrame, int, int]]:
    end_ns, taken = clock() + round(seconds * 1e9), []
    while clock() < end_ns:
        frame = stream.next_frame(1.0)
        if frame is not None:
            taken.append((frame, *stream.exposed_ns))
            stream.release(frame)
    return taken


def test_the_limit_of_silence_follows_period_and_exposure() -> None:
    assert silence_limit_s(1 / 30, 0.01) == 0.5
    assert silence_limit_s(0.2, 0.01) == 1.0
    assert silence_limit_s(0.5, 0.01) == 1.5
    assert silence_limit_s(1 / 30, 1.0) == 2.0
    assert silence_limit_s(10.0, 0.01) == 20.0


def test_times_of_exposures_are_those_of_this_machine(make_device: Callable[..., Any], clock: Any) -> None:
    """Up to the constant delay of the transfer, although the device's clock has another zero and another rate."""
    device = make_device(SCENE, jitter_s=0.004, skew=5e-5, device_offset_ns=-(10**12) + 77)
    stream = FrameStream(device, "cam0", clock, 0.1)
    stream.open()
    taken = _take(stream, clock, 120.0)
    assert stream.clock_name == "fit"
    late = np.array([start_ns - device.start_ns[frame.frame_id] for frame, start_ns, _ in taken[600:]]) * 1e-9
    assert late.std() < 1e-4
    assert late.mean() == pytest.approx(device.transfer_s, abs=1e-3)
    assert stream.clock_map.skew_ppm == pytest.approx(50.0, abs=3.0)
    assert all(end_ns - start_ns == 5_000_000 for _, start_ns, end_ns in taken)


def test_without_a_clock_of_its_own_the_arrival_counts(make_device: Callable[..., Any], clock: Any) -> None:
    device = make_device(SCENE, capabilities=DeviceCapabilities(exposure_range_s=(1e-5, 1.0)))
    stream = FrameStream(device, "cam0", clock)
    stream.open()
    for frame, _, end_ns in _take(stream, clock, 1.0):
        assert end_ns == frame.arrival_ns
    assert stream.clock_name == "arrival"


def test_a_clock_that_is_the_hosts_is_believed(make_device: Callable[..., Any], clock: Any) -> None:
    device = make_device(SCENE, jitter_s=0.01)
    stream = FrameStream(device, "cam0", clock)
    stream.open()
    stream.use_statistics({"clock": "host"})
    for frame, start_ns, _ in _take(stream, clock, 1.0):
        assert start_ns == device.start_ns[frame.frame_id]


def test_a_synchronised_clock_needs_no_fit_only_while_it_is_synchronised(
    make_device: Callable[..., Any], clock: Any
) -> None:
    """A clock on this machine's CLOCK_REALTIME, by PTP: no delay remains."""
    clock.now_ns = time.monotonic_ns()
    device = make_device(SCENE, jitter_s=0.01, device_offset_ns=time.time_ns() - time.monotonic_ns())
    stream = FrameStream(device, "cam0", clock)
    stream.open()
    stream.use_statistics({"ptp_status": "Slave"})
    for frame, start_ns, _ in _take(stream, clock, 1.0):
        assert start_ns == pytest.approx(device.start_ns[frame.frame_id], abs=2e6)
    assert stream.clock_name == "ptp"
    stream.use_statistics({"ptp_status": "Listening"})
    _take(stream, clock, 0.2)
    assert stream.clock_name == "fit"


def test_gaps_in_the_numbers_are_lost_pictures(make_device: Callable[..., Any], clock: Any) -> None:
    device = make_device(SCENE, lost=lambda number: number % 7 == 3)
    stream = FrameStream(device, "cam0", clock)
    stream.open()
    taken = _take(stream, clock, 5.0)
    between = [number for number in device.lost_ids if taken[0][0].frame_id < number < taken[-1][0].frame_id]
    assert stream.gaps == len(between) > 0


def test_a_silent_device_is_noticed_within_two_seconds(make_device: Callable[..., Any], clock: Any) -> None:
    start_ns = clock()
    device = make_device(SCENE, silent=lambda time_s: time_s > start_ns * 1e-9 + 3.0)
    stream = FrameStream(device, "cam0", clock, 0.1)
    stream.open()
    with pytest.raises(CaptureError, match=r"cam0: no picture for 0\.\d s.*opened again"):
        _take(stream, clock, 10.0)
    assert 3.0 < (clock() - start_ns) * 1e-9 < 5.0


def test_a_device_that_never_sends_gets_a_little_longer(make_device: Callable[..., Any], clock: Any) -> None:
    start_ns = clock()
    stream = FrameStream(make_device(SCENE, silent=lambda _: True), "cam0", clock, 0.1)
    stream.open()
    with pytest.raises(CaptureError, match="trigger, packet size and firewall"):
        _take(stream, clock, 10.0)
    assert (clock() - start_ns) * 1e-9 == pytest.approx(FIRST_FRAME_S, abs=0.2)


def test_a_device_that_is_known_to_start_at_once_is_opened_again_soon(
    make_device: Callable[..., Any], clock: Any
) -> None:
    start_ns = clock()
    stream = FrameStream(make_device(SCENE, silent=lambda at: at > start_ns * 1e-9 + 2.0), "cam0", clock, 0.1)

    def silence_s() -> float:
        stream.open()
        opened_ns = clock()
        with pytest.raises(CaptureError, match="trigger, packet size and firewall"):
            _take(stream, clock, 10.0)
        stream.close()
        return float((clock() - opened_ns) * 1e-9)

    stream.open()
    with pytest.raises(CaptureError, match="no picture for"):
        _take(stream, clock, 10.0)
    stream.close()
    assert silence_s() == pytest.approx(LEAST_FIRST_FRAME_S, abs=0.2)
    # Perhaps that was too short: it has the full time again.
    assert silence_s() == pytest.approx(FIRST_FRAME_S, abs=0.2)


def test_long_exposures_are_no_silence(make_device: Callable[..., Any], clock: Any) -> None:
    stream = FrameStream(make_device(SCENE), "cam0", clock, 0.1)
    stream.open()
    stream.set_exposure(Exposure(time_s=1.0))
    assert len(_take(stream, clock, 10.0)) >= 9


def _watch(pictures: Any, step_s: float = 0.1) -> list[bool]:
    watch, found = FrozenWatch(), []
    for number, picture in enumerate(pictures):
        watch.observe(0, picture, round(number * step_s * 1e9))
        found.append(watch.is_frozen(round(number * step_s * 1e9)))
    return found


def _noisy(count: int, seed: int = 1) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    scene = rng.integers(20, 200, 20000)
    return [(scene + rng.normal(0, 1.5, scene.size)).clip(0, 255).astype(np.uint8) for _ in range(count)]


def test_a_noisy_sensor_that_stops_changing_is_frozen_and_thaws() -> None:
    pictures = _noisy(40)
    found = _watch([*pictures, *[pictures[-1]] * 30, *_noisy(3, 2)])
    assert not any(found[:60])
    assert all(found[61:70])
    assert not any(found[70:])


def test_what_never_had_noise_is_not_frozen() -> None:
    """A simulated camera, or a denoised video, in a room where nothing happens; some movement before does not make it noisy."""
    pictures = _noisy(1) * 200
    for number in range(60):
        pictures[number] = pictures[number].copy()
        pictures[number][100 * number : 100 * number + 100] = 7
    assert not any(_watch(pictures))


@pytest.mark.parametrize("value", [0, 255])
def test_a_covered_or_dazzled_sensor_is_not_frozen(value: int) -> None:
    assert not any(_watch([*_noisy(40), *[np.full(20000, value, np.uint8)] * 50]))


def test_exposures_of_a_bracket_are_compared_with_their_like() -> None:
    watch = FrozenWatch()
    first, second = _noisy(40), _noisy(40, 3)
    for number in range(90):
        picture = (first, second)[number % 2][min(number // 2, 39)]
        watch.observe(number % 2, picture, number * 100_000_000)
    assert not watch.is_frozen(90 * 100_000_000)
    for number in range(90, 130):
        watch.observe(number % 2, (first, second)[number % 2][39], number * 100_000_000)
    assert watch.is_frozen(130 * 100_000_000)


def test_rounding_is_no_change_of_the_exposure() -> None:
    assert not exposure_differs(0.01, 0.010149)
    assert exposure_differs(0.01, 0.0103)
    assert exposure_differs(0.01, 0.005)
