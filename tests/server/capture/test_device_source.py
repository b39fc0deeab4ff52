"""A whole camera in virtual time: pictures out of a scripted device, faults in words, and an end of silence."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from nearfield_server.capture.darkroom import Darkroom
from nearfield_server.capture.device import DeviceCapabilities, Exposure
from nearfield_server.capture.device_source import DeviceCamera, DeviceSource, pictures_per_second
from nearfield_server.capture.source import RawFrame
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import AravisSourceTable

HEIGHT, WIDTH = 128, 256  # labels are checked by blocks of 8 x 64 pixels
CODES = 4095.0
RNG = np.random.default_rng(1)
SCENE = np.exp(RNG.uniform(np.log(0.5), np.log(150.0), (HEIGHT, WIDTH)))
BRACKET = {"mode": "bracket", "exposures_s": (0.08, 0.02, 0.005, 0.00125)}
TRIGGER = DeviceCapabilities(exposure_range_s=(1e-5, 1.0), software_trigger=True, device_clock=True)


Rig = Callable[..., tuple[DeviceSource, Any]]


@pytest.fixture
def rig(make_device: Callable[..., Any], clock: Any) -> Rig:
    """Makes a source and its device; `table` are keys of the room file, all else is the device's script."""

    def make(
        scene: Any = SCENE, *, table: dict[str, Any] | None = None, rate: float = 10.0, **script: Any
    ) -> tuple[DeviceSource, Any]:
        source_table = AravisSourceTable.model_validate(
            {"kind": "aravis", "address": "127.0.0.2", "pixel_format": "Mono12", **(table or {})}
        )
        camera = DeviceCamera(
            camera_id="cam0", table=source_table, height=HEIGHT, width=WIDTH, frame_rate=rate
        )
        device = make_device(scene, period_s=1.0 / rate, **script)
        return DeviceSource(
            camera, device, Darkroom("cam0", source_table, WIDTH, HEIGHT), clock=clock
        ), device

    return make


def _run(source: DeviceSource, clock: Any, seconds: float, busy_s: float = 0.0) -> list[RawFrame]:
    """The loop of the capture process; pictures are copied."""
    stop, frames, end_ns = threading.Event(), [], clock() + round(seconds * 1e9)
    while clock() < end_ns:
        before_ns = clock()
        source.wait_for_frame(stop, 0.1)
        assert clock() - before_ns <= 160_000_000
        frame = source.next_frame(clock())
        clock.advance(0.001)
        if frame is not None:
            clock.advance(busy_s)
            assert frame.timestamp_ns < clock()
            frames.append(
                RawFrame(
                    pixels=frame.pixels.copy(),
                    timestamp_ns=frame.timestamp_ns,
                    content_revision=frame.content_revision,
                    counters=frame.counters,
                    metadata=frame.metadata,
                )
            )
    return frames


def _assert_radiance(frames: Sequence[RawFrame], device: Any, sigmas: float = 6.0) -> None:
    """Within the noise of the scene that was there, and of half floats."""
    for frame in frames:
        shown = [device.shown[number] for number in frame.metadata["frame_ids"]]
        low, high = np.min(shown, axis=0), np.max(shown, axis=0)
        amounts = np.array(frame.metadata["exposures_s"]) * np.array(frame.metadata["gains"])
        # Weights are the amounts: a mean of signal / amount weighted with amount^2, over what is not saturated.
        valid = [high * amount * CODES < 3800 for amount in amounts]
        used = sum(amount**2 * each for amount, each in zip(amounts, valid, strict=True))
        noise = sum(
            amount**2 * each * (high * amount / CODES + 1.2 / CODES**2)
            for amount, each in zip(amounts, valid, strict=True)
        )
        sd = np.sqrt(noise) / np.maximum(used, 1e-12) + high * 2.0**-11
        found = frame.pixels[..., 0]
        is_bound = (frame.pixels[..., 3] < 1.0) | (used == 0)
        assert (found[~is_bound] > (low - sigmas * sd)[~is_bound]).all()
        assert (found[~is_bound] < (high + sigmas * sd)[~is_bound]).all()
        assert (found[is_bound] < (high * 1.1 + 6 * sd)[is_bound]).all()


def test_single_pictures_in_radiance_at_the_middle_of_their_exposure(rig: Rig, clock: Any) -> None:
    source, device = rig(jitter_s=0.002)
    source.open()
    frames = _run(source, clock, 10.0)
    assert len(frames) == pytest.approx(100, abs=2)
    assert [frame.content_revision for frame in frames] == list(range(1, len(frames) + 1))
    _assert_radiance(frames, device)
    for frame in frames[10:]:
        [number] = frame.metadata["frame_ids"]
        middle_ns = device.start_ns[number] + 2_500_000
        assert frame.timestamp_ns - middle_ns == pytest.approx(10_000_000, abs=4_000_000)  # the transfer
    assert frames[0].metadata["exposures_s"] == [0.005]
    assert frames[0].metadata["device_ns"] == [str(device.start_ns[frames[0].metadata["frame_ids"][0]])]
    assert not device.lent
    described = source.describe()
    assert described["exposure_s"] == [0.005]
    assert (described["pixel_format"], described["clock_source"], described["model"]) == (
        "Mono12",
        "fit",
        "Scripted",
    )
    assert described["warnings"] == []
    source.close()
    source.close()


def test_the_newest_picture_wins_when_the_reader_is_slow(rig: Rig, clock: Any) -> None:
    source, device = rig()
    source.open()
    frames = _run(source, clock, 10.0, busy_s=0.27)
    assert source.describe()["frames_skipped"] > 30
    for frame in frames:
        assert clock() >= frame.timestamp_ns
    taken = [frame.metadata["frame_ids"][0] for frame in frames]
    assert all(after - before >= 2 for before, after in itertools.pairwise(taken[1:]))
    assert not device.lent


def test_triggered_single_pictures(rig: Rig, clock: Any) -> None:
    source, device = rig(table={"trigger": "software"}, capabilities=TRIGGER)
    source.open()
    frames = _run(source, clock, 10.0)
    assert device.triggers == pytest.approx(100, abs=2)
    assert len(frames) == pytest.approx(100, abs=2)
    _assert_radiance(frames, device)


def test_a_camera_without_the_trigger_that_the_room_file_asks_for(rig: Rig) -> None:
    source, _ = rig(table={"trigger": "software"})
    with pytest.raises(CaptureError, match='no software trigger; use "free"'):
        source.open()


@pytest.mark.parametrize(
    ("capabilities", "label_lag"),
    [
        (
            DeviceCapabilities(
                exposure_range_s=(1e-5, 1), sequencer=True, labels_exposure=True, device_clock=True
            ),
            0,
        ),
        (TRIGGER, -1),
        (DeviceCapabilities(exposure_range_s=(1e-5, 1), device_clock=True), -1),
    ],
    ids=["sequencer", "software_trigger", "free_running"],
)
def test_brackets_hold_the_range_of_the_scene(
    capabilities: DeviceCapabilities, label_lag: int, rig: Rig, clock: Any
) -> None:
    """Five decades in one picture, at every pixel within the noise."""
    scene = np.exp(np.linspace(np.log(0.01), np.log(700.0), HEIGHT * WIDTH)).reshape(HEIGHT, WIDTH)
    source, device = rig(scene, table={"hdr": BRACKET}, capabilities=capabilities, label_lag=label_lag)
    source.open()
    frames = _run(source, clock, 15.0)
    assert len(frames) > 10
    _assert_radiance(frames, device)
    bright = scene > 50
    assert np.median(np.abs(frames[3].pixels[..., 0][bright] / scene[bright] - 1)) < 0.02
    for frame in frames[2:]:
        starts = [device.start_ns[number] for number in frame.metadata["frame_ids"]]
        assert min(starts) < frame.timestamp_ns < max(starts) + 120_000_000
        assert len(frame.metadata["exposures_s"]) == 4
    described = source.describe()
    assert described["bracket_rate"] == pytest.approx(len(frames) / 15.0, rel=0.15)
    assert described["warnings"] == []
    assert not device.lent


def test_a_hardware_trigger_leads_the_camera(rig: Rig, clock: Any) -> None:
    """Then nothing is triggered by software, whatever the camera can do."""
    source, device = rig(table={"hdr": BRACKET, "trigger": "hardware"}, capabilities=TRIGGER)
    source.open()
    assert len(_run(source, clock, 5.0)) > 2
    assert device.triggers == 0
    assert source.describe()["hdr_method"] == "free_running"


def test_a_new_plan_is_taken_up(rig: Rig, clock: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    source, device = rig(table={"hdr": BRACKET}, capabilities=TRIGGER)
    plans = [(Exposure(time_s=0.04), Exposure(time_s=0.004))]
    monkeypatch.setattr(Darkroom, "next_plan", lambda self, exposures: plans.pop(0) if plans else None)
    source.open()
    frames = _run(source, clock, 5.0)
    assert len(frames[0].metadata["exposures_s"]) == 4
    assert [frame.metadata["exposures_s"] for frame in frames[1:]] == [[0.04, 0.004]] * (len(frames) - 1)
    assert source.describe()["exposure_s"] == [0.04, 0.004]
    _assert_radiance(frames, device)


def test_silence_is_a_fault_and_opening_again_applies_everything(rig: Rig, clock: Any) -> None:
    start_s = clock() * 1e-9
    source, device = rig(
        table={"hdr": BRACKET},
        capabilities=TRIGGER,
        silent=lambda time_s: 3.0 < time_s - start_s < 5.0,
    )
    source.open()
    first = _run(source, clock, 2.9)
    with pytest.raises(CaptureError, match="no picture for"):
        _run(source, clock, 10.0)
    assert clock() * 1e-9 - start_s < 3.0 + 2.0
    source.close()
    clock.advance(1.0)
    source.open()
    assert len(device.commands) == 1  # the device has forgotten everything
    again = _run(source, clock, 3.0)
    _assert_radiance(again, device)
    assert again[0].metadata["exposures_s"] == list(BRACKET["exposures_s"])
    revisions = [frame.content_revision for frame in [*first, *again]]
    assert revisions == sorted(set(revisions))
    assert source.describe()["reconnects"] == 1


def test_an_unplugged_camera_is_told_while_waiting(rig: Rig, clock: Any) -> None:
    start_s = clock() * 1e-9
    source, device = rig(gone=lambda time_s: time_s - start_s > 1.0)
    source.open()
    with pytest.raises(CaptureError, match="unplugged"):
        _run(source, clock, 3.0)
    source.close()
    with pytest.raises(CaptureError, match="before open"):
        source.next_frame(0)
    assert device.closed == 1


def test_a_device_clock_that_jumps_moves_no_picture_in_time(rig: Rig, clock: Any) -> None:
    source, device = rig()
    source.open()
    before = _run(source, clock, 20.0)
    device.device_offset_ns = 10**15
    after = _run(source, clock, 20.0)
    times = np.array([frame.timestamp_ns for frame in [*before, *after]])
    assert np.diff(times).min() > 0.08e9
    assert np.diff(times).max() < 0.12e9
    assert source.describe()["clock_jumps"] == 1


def test_an_exposure_that_someone_else_changes_is_noticed_and_set_again(rig: Rig, clock: Any) -> None:
    source, device = rig()
    source.open()
    _run(source, clock, 2.0)
    device.meddle(Exposure(time_s=0.02))
    frames = _run(source, clock, 3.0)
    assert device.commands[-1][1].time_s == 0.005
    assert "changed by someone else to 0.02 s" in source.describe()["warnings"][0]
    # Wrong at most for the time between two looks at the device and what the device needs to obey.
    truth = [device.truth[frame.metadata["frame_ids"][0]].time_s for frame in frames]
    said = [frame.metadata["exposures_s"][0] for frame in frames]
    assert sum(true != each for true, each in zip(truth, said, strict=True)) <= 5
    assert said[-15:] == truth[-15:] == [0.005] * 15
    _run(source, clock, 12.0)
    assert source.describe()["warnings"] == []


def test_labels_are_believed_at_once_where_the_device_has_them(rig: Rig, clock: Any) -> None:
    capabilities = DeviceCapabilities(exposure_range_s=(1e-5, 1), labels_exposure=True, device_clock=True)
    source, device = rig(capabilities=capabilities, label_lag=0)
    source.open()
    _run(source, clock, 1.0)
    device.meddle(Exposure(time_s=0.02))
    frames = _run(source, clock, 2.0)
    _assert_radiance(frames, device)
    assert {frame.metadata["exposures_s"][0] for frame in frames} == {0.005, 0.02}


def test_a_frozen_picture_is_withheld_and_the_camera_opened_again(rig: Rig, clock: Any) -> None:
    source, device = rig(frozen_from=180)
    source.open()
    frames = _run(source, clock, 12.0)
    assert len(frames) == pytest.approx(80 + 20, abs=4)
    assert any("same picture again and again" in words for words in source.describe()["warnings"])
    with pytest.raises(CaptureError, match="frozen, bit for bit"):
        _run(source, clock, 10.0)
    source.close()
    device.frozen_from = 1 << 60
    source.open()
    assert len(_run(source, clock, 2.0)) >= 18


def test_a_noise_free_camera_in_a_still_room_is_not_frozen(rig: Rig, clock: Any) -> None:
    source, _ = rig(noise=0.0)
    source.open()
    assert len(_run(source, clock, 20.0)) >= 198
    assert source.describe()["warnings"] == []


def test_black_and_saturated_pictures_are_told_in_words(rig: Rig, clock: Any) -> None:
    source, _ = rig(np.full((HEIGHT, WIDTH), 0.001), noise=0.3)
    source.open()
    assert len(_run(source, clock, 3.0)) > 20
    assert "picture is black" in source.describe()["warnings"][0]
    source, _ = rig(SCENE * 20)
    source.open()
    frames = _run(source, clock, 3.0)
    assert "% of the pixels are saturated" in source.describe()["warnings"][0]
    assert source.describe()["saturated_share"] > 0.02
    assert frames[-1].counters["saturated"] == (frames[-1].pixels[..., 3] < 1).sum()
    source, _ = rig(SCENE * 20, table={"hdr": BRACKET}, capabilities=TRIGGER)
    source.open()
    _run(source, clock, 3.0)
    assert "saturated even at 0.00125 s" in source.describe()["warnings"][0]


def test_warnings_of_the_device_are_passed_on(rig: Rig, clock: Any) -> None:
    source, _ = rig(extra_statistics={"warnings": "small buffer\nold firmware", "temperature_c": 41.5})
    source.open()
    _run(source, clock, 1.0)
    assert source.describe()["warnings"] == ["small buffer", "old firmware"]
    assert source.describe()["temperature_c"] == 41.5


def test_the_rate_asked_of_a_device_makes_whole_brackets() -> None:
    def table(hdr: dict[str, Any]) -> AravisSourceTable:
        return AravisSourceTable.model_validate({"kind": "aravis", "address": "127.0.0.2", "hdr": hdr})

    assert pictures_per_second(table({"mode": "off"}), 10.0) == 10.0
    assert pictures_per_second(table(BRACKET), 10.0) == 40.0
    assert pictures_per_second(table({"mode": "bracket", "num_exposures": 3}), 10.0) == 30.0


@pytest.mark.parametrize("seed", range(6))
def test_random_faults_never_give_wrong_radiance(seed: int, rig: Rig, clock: Any) -> None:
    """Losses, late settings, lying labels, switched lamps, silence and jumps of the clock: every pixel stays between what it was in the
    course of its bracket, within the noise."""
    rng = np.random.default_rng(seed)
    start_s = clock() * 1e-9
    switches = np.sort(rng.uniform(0.0, 30.0, 8))
    levels = rng.choice([0.5, 1.0, 3.0], 9)
    capabilities, label_lag = [
        (
            DeviceCapabilities(
                exposure_range_s=(1e-5, 1), sequencer=True, labels_exposure=True, device_clock=True
            ),
            int(rng.integers(0, 2)),
        ),
        (TRIGGER, -1),
        (DeviceCapabilities(exposure_range_s=(1e-5, 1), device_clock=True), -1),
    ][seed % 3]
    source, device = rig(
        lambda time_s: SCENE * levels[np.searchsorted(switches, time_s - start_s)],
        table={"hdr": BRACKET},
        capabilities=capabilities,
        label_lag=label_lag,
        effect_frames=int(rng.integers(0, 4)),
        lost=lambda _id: rng.random() < 0.05,
        silent=lambda time_s: 12.0 < time_s - start_s < 14.0,
        jitter_s=0.005,
    )
    source.open()
    frames, faults = [], 0
    for _ in range(30):
        try:
            frames += _run(source, clock, 1.0)
        except CaptureError:
            faults += 1
            source.close()
            clock.advance(0.3)
            source.open()
        if rng.random() < 0.1:
            device.device_offset_ns += int(rng.integers(-(10**10), 10**10))
    assert faults >= 1
    assert len(frames) > 15
    _assert_radiance(frames, device)
    times = [frame.timestamp_ns for frame in frames]
    assert times == sorted(set(times))
