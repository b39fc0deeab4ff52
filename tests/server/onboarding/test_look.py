"""Looks at pictures that are known, and a viewer with a camera that does as it is told."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest

from nearfield_server.capture.device import DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.errors import CaptureError
from nearfield_server.imaging.preview import BOUND_MARK, as_exposed
from nearfield_server.onboarding.look import HISTOGRAM_BINS, Look, better_exposure, take_look
from nearfield_server.onboarding.viewer import Viewer, Wish

LOWER_BOUND = np.uint16(0x3BFF).view(np.float16)


def _look(signal: np.ndarray) -> Look:
    return take_look(signal, pixel_format="Mono8", exposure_s=0.01, exposure_range_s=(1e-5, 1.0))


def test_histogram_and_saturated_share() -> None:
    signal = np.zeros((40, 60, 4), np.float32)
    signal[..., 3] = 1.0
    signal[:10, :, 1] = 0.5  # a quarter, in the strongest channel
    signal[:4, :, :3] = 1.2
    signal[:4, :, 3] = LOWER_BOUND
    look = _look(signal)
    assert sum(look.histogram) == pytest.approx(1.0)
    assert (look.histogram[0], look.histogram[HISTOGRAM_BINS // 2], look.histogram[-1]) == pytest.approx(
        (0.75, 0.15, 0.1)
    )
    assert look.saturated_share == pytest.approx(0.1)
    assert (look.width, look.height, look.has_circle) == (60, 40, False)
    picture = cv2.imdecode(np.frombuffer(look.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (40, 60, 3)


def test_pictures_are_as_bright_as_they_are_exposed() -> None:
    signal = np.ones((8, 8, 4), np.float32)
    signal[..., :3] = 0.21404114  # middle of the sRGB codes
    np.testing.assert_array_equal(as_exposed(signal, max_side=8), 128)
    signal[2, 3, 3] = LOWER_BOUND
    assert tuple(as_exposed(signal, max_side=8)[2, 3]) == BOUND_MARK
    assert tuple(as_exposed(signal, max_side=8, marks=False)[2, 3]) == (128, 128, 128)


@pytest.mark.parametrize(
    ("bright", "longest_s", "expected"),
    [
        (0.2, 1.0, 0.02),
        (0.8, 1.0, 0.005),
        (0.0, 10.0, 0.16),  # black: as far as a step goes
        (0.001, 10.0, 0.16),
        (0.0, 0.1, 0.1),
        (1.0, 1.0, 0.01 / 16),
        (0.4, 1.0, 0.01),
    ],
)
def test_better_exposures(bright: float, longest_s: float, expected: float) -> None:
    signal = np.full((8, 8, 4), bright, np.float32)
    signal[..., 3] = 1.0
    look = _look(signal)
    assert look.bright == pytest.approx(bright)
    assert better_exposure(look, longest_s) == pytest.approx(expected)


def test_better_exposures_stay_within_what_the_camera_can_do() -> None:
    signal = np.zeros((8, 8, 4), np.float32)
    look = take_look(signal, pixel_format="Mono8", exposure_s=0.01, exposure_range_s=(0.005, 0.02))
    assert better_exposure(look, 1.0) == 0.02
    bright = take_look(signal + 1, pixel_format="Mono8", exposure_s=0.01, exposure_range_s=(0.005, 0.02))
    assert better_exposure(bright, 1.0) == 0.005
    fixed = take_look(signal, pixel_format="Mono8", exposure_s=0.01, exposure_range_s=(0.01, 0.01))
    assert better_exposure(fixed, 0.001) == 0.01


class FakeDevice:
    """Sends frames of a code that is proportional to the exposure, which comes into force two frames late."""

    def __init__(self, log: list[str], threads: set[int], fail_after: int | None = None) -> None:
        self.log, self.threads, self.fail_after = log, threads, fail_after
        self.waiting = 3  # frames of long ago
        self.frames_held = self.frames_sent = 0
        self._pipeline = [0.004, 0.004]
        self._commanded = 0.004

    def open(self) -> DeviceCapabilities:
        self._note("open")
        return DeviceCapabilities(exposure_range_s=(0.001, 0.02), settle_frames=2)

    def close(self) -> None:
        self._note("close")
        assert self.frames_held == 0

    def _note(self, what: str) -> None:
        self.log.append(what)
        self.threads.add(threading.get_ident())

    def set_exposure(self, exposure: Exposure) -> Exposure:
        self._note(f"exposure {exposure.time_s:g}")
        self._commanded = exposure.time_s
        return exposure

    def next_frame(self, timeout_s: float) -> SensorFrame | None:
        self.threads.add(threading.get_ident())
        if self.waiting == 0 and timeout_s == 0.0:
            self.waiting = 1  # the queue fills while nobody looks
            return None
        if self.fail_after is not None and self.frames_sent >= self.fail_after:
            raise CaptureError("cable pulled")
        self.waiting = max(self.waiting - 1, 0)
        self.frames_held += 1
        self.frames_sent += 1
        in_force = self._pipeline.pop(0)
        self._pipeline.append(self._commanded)
        return SensorFrame(
            data=np.full(48, round(10_000 * in_force), np.uint8),
            pixel_format="Mono8",
            width=8,
            height=6,
            frame_id=self.frames_sent,
            device_ns=None,
            arrival_ns=0,
            exposure=Exposure(time_s=in_force),
        )

    def release(self, frame: SensorFrame) -> None:
        self.frames_held -= 1


class Bench:
    """A viewer, and what its devices were told."""

    def __init__(self, **options: int) -> None:
        self.log: list[str] = []
        self.threads: set[int] = set()
        self.devices: list[FakeDevice] = []
        self.options = options
        self.closed = threading.Event()

    def make_device(self) -> FakeDevice:
        # Only the first device breaks.
        options = self.options if not self.devices else {}
        self.devices.append(FakeDevice(self.log, self.threads, **options))
        return self.devices[-1]


def decode(frame: SensorFrame) -> np.ndarray:
    signal = np.ones((frame.height, frame.width, 4), np.float32)
    signal[..., :3] = (frame.data.reshape(frame.height, frame.width) / 255.0)[..., None]
    return signal


@pytest.fixture
def start() -> Iterator[Callable[..., tuple[Viewer, Bench]]]:
    viewers: list[Viewer] = []

    def make(idle_s: float = 60.0, **options: int) -> tuple[Viewer, Bench]:
        bench = Bench(**options)
        viewers.append(Viewer(bench.make_device, decode, idle_s=idle_s))
        return viewers[-1], bench

    yield make
    for viewer in viewers:
        viewer.close()


Start = Callable[..., tuple[Viewer, Bench]]


def _code(look: Look) -> int:
    return round(255 * (np.flatnonzero(look.histogram)[0] + 0.5) / HISTOGRAM_BINS)


def test_every_look_has_the_exposure_that_was_asked_for(start: Start) -> None:
    viewer, bench = start()
    first = viewer.look(Wish())
    assert (first.exposure_s, first.exposure_range_s) == (0.004, (0.001, 0.02))
    for wanted, got in ((0.01, 0.01), (0.01, 0.01), (0.0015, 0.0015), (5.0, 0.02)):
        look = viewer.look(Wish(exposure_s=wanted))
        assert look.exposure_s == got
        assert _code(look) == pytest.approx(10_000 * got, abs=255 / HISTOGRAM_BINS)
    assert bench.log == ["open", "exposure 0.01", "exposure 0.0015", "exposure 0.02"]
    viewer.close()
    assert bench.log[-1] == "close"
    assert len(bench.threads) == 1
    with pytest.raises(CaptureError, match="closed"):
        viewer.look(Wish())


def test_a_camera_that_nobody_looks_at_is_let_go(start: Start) -> None:
    viewer, bench = start(idle_s=0.02)
    viewer.look(Wish(exposure_s=0.01))
    while bench.log[-1] != "close":
        threading.Event().wait(0.01)
    # Devices forget: the exposure is set again.
    assert viewer.look(Wish(exposure_s=0.01)).exposure_s == 0.01
    assert bench.log[:5] == ["open", "exposure 0.01", "close", "open", "exposure 0.01"]


def test_a_failed_look_closes_the_camera_and_the_next_one_opens_it_again(start: Start) -> None:
    viewer, bench = start(fail_after=4)
    viewer.look(Wish())
    with pytest.raises(CaptureError, match="cable pulled"):
        viewer.look(Wish())
    assert viewer.look(Wish()).exposure_s == 0.004
    assert bench.log == ["open", "close", "open"]


def test_a_silent_camera_is_told_in_words(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    viewer, bench = start()
    monkeypatch.setattr(FakeDevice, "next_frame", lambda self, timeout_s: None)
    with pytest.raises(CaptureError, match="no picture within 2 s"):
        viewer.look(Wish())
    assert bench.log == ["open", "close"]


def test_a_picture_that_cannot_be_read_is_an_error_in_words(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer, bench = start()
    monkeypatch.setattr(viewer, "_decode", lambda frame: 1 / 0)
    with pytest.raises(CaptureError, match="ZeroDivisionError"):
        viewer.look(Wish())
    assert bench.devices[0].frames_held == 0
