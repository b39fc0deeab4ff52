"""Three ways to make a device take one exposure after another, and to know which picture has which.

A method hands out shots: a picture with the position of its exposure in the plan. It knows nothing of light; whether the labels are right
is judged from the pixels (`bracketing`). All of them only ever wait inside `next_frame`, and never longer than they are told to.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol

from nearfield_server.capture.device import DeviceCapabilities, Exposure, SensorFrame

MethodName = Literal["sequencer", "software_trigger", "free_running"]
LABEL_TOLERANCE: Final = 0.03
"""Relative difference up to which a labelled exposure is the one that was asked for; devices round, and report in other units."""
_LATE_S: Final = 0.25
_ATTEMPTS: Final = 3
_ON_ITS_WAY_S: Final = 0.1
_MOST_STRAYS: Final = 16
_PATIENCE_FRAMES: Final = 12


class ShotDevice(Protocol):
    """What a method needs of a device; see `device.Device`."""

    def set_exposure(self, exposure: Exposure) -> Exposure:
        """Expose the next frames so."""

    def trigger(self) -> None:
        """Ask for one frame."""

    def use_trigger(self, software: bool) -> None:
        """On request, or free running."""

    def program_sequence(self, exposures: Sequence[Exposure]) -> tuple[Exposure, ...]:
        """Cycle through exposures."""

    def next_frame(self, timeout_s: float) -> SensorFrame | None:
        """Return the oldest whole frame that waits."""

    def release(self, frame: SensorFrame) -> None:
        """Give its memory back."""


@dataclass(frozen=True, slots=True)
class Shot:
    """A picture that belongs to the plan; whoever gets it releases the frame.

    Attributes:
        index: position of its exposure in the plan.
        frame: the picture.
        follows: it was taken right after the shot before, so that both belong to one bracket; false after a loss.
    """

    index: int
    frame: SensorFrame
    follows: bool


class ExposureMethod(Protocol):
    """A way to take the exposures of a plan in turn, for ever."""

    name: MethodName
    exposures: tuple[Exposure, ...]
    """As the device made them; known for each once it was set."""
    frames_unused: int
    """Pictures between two exposures, or with a label that nobody asked for."""

    def start(self, exposures: Sequence[Exposure]) -> None:
        """Begin with a plan; shots of the one before do not come any more."""

    def shoot(self, timeout_s: float) -> Shot | None:
        """Return the next shot; None if there is none within the time, which is not an error."""


def nearest_exposure(exposures: Sequence[Exposure], found: Exposure) -> int | None:
    """Position of the exposure that a label means; None if it is none of them."""
    distances = [abs(math.log(found.amount / exposure.amount)) for exposure in exposures]
    index = min(range(len(exposures)), key=distances.__getitem__)
    return index if distances[index] <= math.log1p(LABEL_TOLERANCE) else None


class Sequencer:
    """The device cycles by itself and labels every picture: the full frame rate, and nothing to wait for."""

    name: MethodName = "sequencer"

    def __init__(self, device: ShotDevice, *, is_free: bool = True) -> None:
        """Keep the device.

        Args:
            device: with `sequencer` and `labels_exposure`.
            is_free: let it run freely; false where a hardware trigger leads it.
        """
        self._device, self._is_free = device, is_free
        self.exposures: tuple[Exposure, ...] = ()
        self.frames_unused = 0
        self._last_id: int | None = None

    def start(self, exposures: Sequence[Exposure]) -> None:
        """Program the device."""
        if self._is_free and not self.exposures:
            self._device.use_trigger(False)
        self.exposures = self._device.program_sequence(exposures)
        self._last_id = None

    def shoot(self, timeout_s: float) -> Shot | None:
        """Return the next picture that carries a label of the plan."""
        frame = self._device.next_frame(timeout_s)
        if frame is None:
            return None
        index = nearest_exposure(self.exposures, frame.exposure) if frame.is_labelled else None
        if index is None:
            # Of the plan before, or the label was lost on the way.
            self._device.release(frame)
            self.frames_unused += 1
            return None
        follows = self._last_id is None or frame.frame_id == self._last_id + 1
        self._last_id = frame.frame_id
        return Shot(index, frame, follows)


class SoftwareTrigger:
    """Set, ask, take: each picture has the exposure that was set before it was asked for.

    The next exposure is set once the picture has arrived, never while it is read out and sent. Nobody knows from outside when a camera
    begins to expose after a trigger; a busy one that is overtaken by the next setting gives a picture a wrong exposure, and in a dark
    room the pixels cannot tell.
    """

    name: MethodName = "software_trigger"

    def __init__(self, device: ShotDevice, clock: Callable[[], int], period_s: float = 0.0) -> None:
        """Keep the device.

        Args:
            device: with `software_trigger`.
            clock: CLOCK_MONOTONIC, ns.
            period_s: a plan is begun anew at most this often.
        """
        self._device, self._clock, self._period_ns = device, clock, round(period_s * 1e9)
        self.exposures: tuple[Exposure, ...] = ()
        self.frames_unused = 0
        self.triggers_lost = 0
        self._plan: tuple[Exposure, ...] = ()
        self._begun_ns = -self._period_ns
        self._is_switched = False

    def start(self, exposures: Sequence[Exposure]) -> None:
        """Switch to triggered pictures, once: cameras stop their stream for it."""
        if not self._is_switched:
            self._device.use_trigger(True)
            self._is_switched = True
        self._plan = self.exposures = tuple(exposures)
        self._index, self._attempts, self._follows = 0, 0, True
        self._triggered_ns: int | None = None
        self._set: int | None = None
        # A picture that is still on its way would be taken for the answer to the first trigger, and so on for ever.
        self._drain(_ON_ITS_WAY_S)

    def shoot(self, timeout_s: float) -> Shot | None:
        """Trigger if nothing is under way, and wait for the picture."""
        end_ns = self._clock() + round(timeout_s * 1e9)
        if self._triggered_ns is None:
            if self._index == 0 and self._attempts == 0 and not self._may_begin(end_ns):
                return None
            self._apply(self._index)
            self._triggered_ns = self._clock()
            self._device.trigger()
        frame = self._next(end_ns)
        if frame is not None:
            return self._taken(frame)
        exposed_ns = self._triggered_ns + round(1.1e9 * self.exposures[self._index].time_s)
        if self._clock() - exposed_ns > _LATE_S * 1e9:
            self._lost()
        return None

    def _may_begin(self, end_ns: int) -> bool:
        """Wait for the time of the next plan (stray pictures are thrown away meanwhile); false if it is not reached."""
        due_ns = self._begun_ns + self._period_ns
        while self._clock() < min(due_ns, end_ns):
            frame = self._next(min(due_ns, end_ns))
            if frame is not None:
                self._throw_away(frame)
        if self._clock() < due_ns:
            return False
        # Kept to the grid of the period, but late plans are not caught up with.
        self._begun_ns = due_ns if self._clock() - due_ns < self._period_ns else self._clock()
        return True

    def _apply(self, index: int) -> None:
        if self._set != index:
            rounded = self._device.set_exposure(self._plan[index])
            self.exposures = (*self.exposures[:index], rounded, *self.exposures[index + 1 :])
            self._set = index

    def _next(self, end_ns: int) -> SensorFrame | None:
        return self._device.next_frame(max(0.0, (end_ns - self._clock()) * 1e-9))

    def _taken(self, frame: SensorFrame) -> Shot | None:
        assert self._triggered_ns is not None
        if frame.arrival_ns < self._triggered_ns:
            # The late answer to a trigger that was given up.
            self._throw_away(frame)
            return None
        shot = Shot(self._index, frame, self._follows)
        self._index = (self._index + 1) % len(self._plan)
        self._attempts, self._follows, self._triggered_ns = 0, True, None
        return shot

    def _lost(self) -> None:
        """Ask again for the same exposure; give the bracket up after a few attempts."""
        self.triggers_lost += 1
        self._triggered_ns, self._attempts = None, self._attempts + 1
        self._drain()
        if self._attempts >= _ATTEMPTS:
            self._index, self._attempts, self._follows = 0, 0, False

    def _drain(self, quiet_s: float = 0.0) -> None:
        for _ in range(_MOST_STRAYS):
            frame = self._device.next_frame(quiet_s)
            if frame is None:
                break
            self._throw_away(frame)

    def _throw_away(self, frame: SensorFrame) -> None:
        self._device.release(frame)
        self.frames_unused += 1


class FreeRunning:
    """Set, let the pictures pass that may still have the exposure before, take. Works with every device, at a fraction of its rate."""

    name: MethodName = "free_running"

    def __init__(
        self, device: ShotDevice, clock: Callable[[], int], settle_frames: int, *, is_free: bool = True
    ) -> None:
        """Keep the device.

        Args:
            device: any.
            clock: CLOCK_MONOTONIC, ns.
            settle_frames: pictures after a change that may still have the old exposure; not needed of devices that label theirs.
            is_free: let it run freely; false where a hardware trigger leads it.
        """
        self._device, self._clock, self._is_free = device, clock, is_free
        self.settle_frames = settle_frames
        self.exposures: tuple[Exposure, ...] = ()
        self.frames_unused = 0
        self._plan: tuple[Exposure, ...] = ()

    def start(self, exposures: Sequence[Exposure]) -> None:
        """Let the device run, at the first exposure."""
        if self._is_free and not self._plan:
            self._device.use_trigger(False)
        self._plan = self.exposures = tuple(exposures)
        self._set_index(0)

    def _set_index(self, index: int) -> None:
        self._index = index
        rounded = self._device.set_exposure(self._plan[index])
        self.exposures = (*self.exposures[:index], rounded, *self.exposures[index + 1 :])
        self._set_ns = self._clock()
        self._first_id: int | None = None

    def shoot(self, timeout_s: float) -> Shot | None:
        """Take the next picture; it is a shot if its exposure is the one that was set."""
        frame = self._device.next_frame(timeout_s)
        if frame is None:
            return None
        if frame.arrival_ns > self._set_ns and self._first_id is None:
            self._first_id = frame.frame_id
        passed = -1 if self._first_id is None else frame.frame_id - self._first_id
        wanted = self.exposures[self._index]
        has_label = frame.is_labelled and nearest_exposure([wanted], frame.exposure) == 0
        if has_label or (not frame.is_labelled and passed >= self.settle_frames):
            shot = Shot(self._index, frame, True)
            self._set_index((self._index + 1) % len(self._plan))
            return shot
        self._device.release(frame)
        self.frames_unused += 1
        if passed > _PATIENCE_FRAMES:
            # The device did not do as it was told, or someone else changed the exposure.
            self._set_index(self._index)
        return None


def choose_method(wanted: str, capabilities: DeviceCapabilities) -> MethodName:
    """Return the fastest method that the device can do, or the wanted one.

    Args:
        wanted: "auto" or a method; one that the device cannot do is replaced by one that it can.
        capabilities: of the device.
    """
    usable: list[MethodName] = ["free_running"]
    if capabilities.software_trigger:
        usable.insert(0, "software_trigger")
    if capabilities.sequencer and capabilities.labels_exposure:
        usable.insert(0, "sequencer")
    return next((name for name in usable if name == wanted), usable[0])
