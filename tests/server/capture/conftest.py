"""A camera in virtual time that does as its script says: settings that take effect late, labels that lie, pictures that get lost."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from nearfield_server.capture.device import DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.errors import CaptureError

FULL = 4095
CODES = 4095.0
"""Codes per radiance and second."""


@dataclass
class VirtualClock:
    """CLOCK_MONOTONIC of a test: it moves when someone waits."""

    now_ns: int = 1_000_000_000_000

    def __call__(self) -> int:
        return self.now_ns

    def advance(self, seconds: float) -> None:
        self.now_ns += max(0, round(seconds * 1e9))


def steady(radiance: np.ndarray) -> Callable[[float], np.ndarray]:
    return lambda _time_s: radiance


@dataclass
class ScriptedDevice:
    """`Device` of a linear 12 bit sensor in 16 bit codes ("Mono12").

    Attributes:
        clock: virtual time.
        scene: radiance (H, W) at a time in seconds; it is sampled in the middle of the exposure.
        effect_frames: free-running pictures after a change that still have the old exposure.
        trigger_delay_s: from a trigger to the exposure; the setting is read then.
        trigger_lag: triggered pictures have the setting of so many settings before.
        label_lag: labels are those of so many pictures before; -1 = none.
        lost: (frame id) -> whether the picture is lost on the way.
        noise: standard deviation, codes, on top of photon noise of one electron per code.
        frozen_from: from this frame id on, the same picture is sent again.
        silent_from_s: no pictures from this time (seconds of the clock) on; `mute` until then.
        skew: the device's clock runs slower by this share.
    """

    clock: VirtualClock
    scene: Callable[[float], np.ndarray]
    period_s: float = 0.1
    transfer_s: float = 0.01
    jitter_s: float = 0.0
    capabilities: DeviceCapabilities = field(
        default_factory=lambda: DeviceCapabilities(exposure_range_s=(1e-5, 1.0), device_clock=True)
    )
    effect_frames: int = 1
    trigger_delay_s: float = 0.0
    trigger_lag: int = 0
    label_lag: int = -1
    lost: Callable[[int], bool] = lambda _id: False
    noise: float = 1.0
    frozen_from: int = 1 << 60
    silent: Callable[[float], bool] = lambda _time: False
    gone: Callable[[float], bool] = lambda _time: False
    rounding_s: float = 1e-6
    num_buffers: int = 4
    skew: float = 0.0
    device_offset_ns: int = 0
    seed: int = 1
    pixel_format: str = "Mono12"
    extra_statistics: dict[str, str | int | float | bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.opened = self.closed = 0
        self.truth: dict[int, Exposure] = {}
        self.shown: dict[int, np.ndarray] = {}
        self.commands: list[tuple[int, Exposure]] = []
        self.triggers = 0
        self.lent: set[int] = set()
        self.lost_ids: list[int] = []
        self.start_ns: dict[int, int] = {}
        self._is_open = False
        self._last_arrival_ns = 0
        self._next_id = 100
        self._history: deque[Exposure] = deque(maxlen=8)
        self._frozen: np.ndarray | None = None

    def open(self) -> DeviceCapabilities:
        assert not self._is_open
        self.opened += 1
        self.clock.advance(0.05)
        if self.gone(self.clock.now_ns * 1e-9):
            raise CaptureError("camera scripted: no answer; is it switched on?")
        self._is_open, self._software = True, False
        self._sequence: tuple[Exposure, ...] = ()
        self._queue: deque[SensorFrame] = deque()
        self._waiting: deque[tuple[int, int]] = deque()
        self._next_start_ns = self.clock.now_ns
        self._due_ns: deque[int] = deque()
        self._commanded = Exposure(time_s=0.005)
        self.commands = [(self.clock.now_ns - 10**12, self._commanded)]
        return self.capabilities

    def close(self) -> None:
        self.closed += 1
        self._is_open = False
        self.lent.clear()

    def _rounded(self, exposure: Exposure) -> Exposure:
        steps = max(1, round(exposure.time_s / self.rounding_s))
        low, high = self.capabilities.exposure_range_s
        return replace(exposure, time_s=min(max(steps * self.rounding_s, low), high))

    def set_exposure(self, exposure: Exposure) -> Exposure:
        assert self._is_open
        self._catch_up(self.clock.now_ns)
        self._commanded = self._rounded(exposure)
        self.commands.append((self.clock.now_ns, self._commanded))
        self.clock.advance(0.0003)
        return self._commanded

    def read_exposure(self) -> Exposure:
        return self._commanded

    def meddle(self, exposure: Exposure) -> None:
        """Another program sets the exposure."""
        self._commanded = exposure
        self.commands.append((self.clock.now_ns, exposure))

    def trigger(self) -> None:
        assert self._software
        self.triggers += 1
        self._due_ns.append(self.clock.now_ns + round(self.trigger_delay_s * 1e9))
        self._catch_up(self.clock.now_ns)

    def use_trigger(self, software: bool) -> None:
        assert self._is_open
        self._catch_up(self.clock.now_ns)
        if self._software and not software:
            self._next_start_ns = self.clock.now_ns
        self._software = software

    def program_sequence(self, exposures: Sequence[Exposure]) -> tuple[Exposure, ...]:
        assert self.capabilities.sequencer
        self._catch_up(self.clock.now_ns)
        self._sequence = tuple(self._rounded(exposure) for exposure in exposures)
        return self._sequence

    def _in_effect(self, start_ns: int) -> Exposure:
        """Triggered sensors take the newest setting less the scripted lag; free-running ones settings older than some periods."""
        if self._software:
            return self.commands[max(0, len(self.commands) - 1 - self.trigger_lag)][1]
        limit_ns = start_ns - round(self.effect_frames * self.period_s * 1e9)
        return [
            exposure
            for set_ns, exposure in self.commands
            if set_ns <= limit_ns or set_ns == self.commands[0][0]
        ][-1]

    def _expose(self, start_ns: int, exposure: Exposure) -> None:
        number, self._next_id = self._next_id, self._next_id + 1
        self._history.append(exposure)
        self.truth[number] = exposure
        middle_s = start_ns * 1e-9 + 0.5 * exposure.time_s
        if self.silent(middle_s):
            return
        radiance = self.scene(middle_s)
        self.shown[number] = radiance
        electrons = radiance * exposure.amount * CODES
        codes = electrons + np.sqrt(electrons + self.noise**2) * self.rng.standard_normal(radiance.shape) * (
            self.noise > 0
        )
        pixels = np.clip(np.rint(codes), 0, FULL).astype("<u2")
        if number >= self.frozen_from:
            pixels = self._frozen = pixels if self._frozen is None else self._frozen
        delay_s = exposure.time_s + self.transfer_s + self.rng.exponential(self.jitter_s)
        arrival_ns = self._last_arrival_ns = max(start_ns + round(delay_s * 1e9), self._last_arrival_ns)
        label = self._history[-1 - self.label_lag] if 0 <= self.label_lag < len(self._history) else None
        self.start_ns[number] = start_ns
        if self.lost(number) or len(self._queue) >= self.num_buffers - len(self.lent):
            self.lost_ids.append(number)
            return
        self._queue.append(
            SensorFrame(
                data=pixels.copy().reshape(-1).view(np.uint8),
                pixel_format=self.pixel_format,
                width=radiance.shape[1],
                height=radiance.shape[0],
                row_bytes=2 * radiance.shape[1],
                frame_id=number,
                device_ns=round(start_ns / (1 + self.skew)) + self.device_offset_ns
                if self.capabilities.device_clock
                else None,
                arrival_ns=arrival_ns,
                exposure=label or self.commands[-1][1],
                is_labelled=label is not None,
            )
        )

    def _catch_up(self, until_ns: int) -> None:
        """Pictures whose exposure begins up to a time."""
        while self._due_ns and self._due_ns[0] <= until_ns:
            start_ns = self._due_ns.popleft()
            self._expose(start_ns, self._in_effect(start_ns))
        while not self._software and self._next_start_ns <= until_ns:
            start_ns = self._next_start_ns
            exposure = (
                self._sequence[self._next_id % len(self._sequence)]
                if self._sequence
                else self._in_effect(start_ns)
            )
            self._expose(start_ns, exposure)
            self._next_start_ns += round(max(self.period_s, exposure.time_s) * 1e9)

    def next_frame(self, timeout_s: float) -> SensorFrame | None:
        assert self._is_open
        if self.gone(self.clock.now_ns * 1e-9):
            raise CaptureError("camera scripted: unplugged")
        end_ns = self.clock.now_ns + round(timeout_s * 1e9)
        while True:
            self._catch_up(self.clock.now_ns)
            if self._queue and self._queue[0].arrival_ns <= self.clock.now_ns:
                frame = self._queue.popleft()
                self.lent.add(frame.frame_id)
                return frame
            if self.clock.now_ns >= end_ns:
                return None
            times = [end_ns]
            if self._queue:
                times.append(self._queue[0].arrival_ns)
            if not self._software:
                times.append(self._next_start_ns)
            elif self._due_ns:
                times.append(self._due_ns[0])
            self.clock.now_ns = max(self.clock.now_ns, min(times))

    def release(self, frame: SensorFrame) -> None:
        self.lent.remove(frame.frame_id)
        frame.data.flags.writeable = True
        frame.data[:] = 0xAA  # whoever still looks at it sees garbage

    def statistics(self) -> dict[str, str | int | float | bool]:
        return {
            "frames_lost": len(self.lost_ids),
            "frames_broken": 0,
            "model": "Scripted",
            **self.extra_statistics,
        }


@pytest.fixture
def clock() -> VirtualClock:
    """Virtual time."""
    return VirtualClock()


@pytest.fixture
def make_device(clock: VirtualClock) -> Callable[..., ScriptedDevice]:
    """Makes a scripted device in the virtual time of the test; the scene may be a picture that does not change."""

    def make(scene: np.ndarray | Callable[[float], np.ndarray], **script: Any) -> ScriptedDevice:
        return ScriptedDevice(clock, scene if callable(scene) else steady(scene), **script)

    return make
