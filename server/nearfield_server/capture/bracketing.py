"""From shots to brackets: pictures of one plan of exposures, complete, taken one after the other, and labelled as the pixels say.

Labels are not believed. Sums over pixels that are valid in two pictures give the ratio of their exposures within a percent; a label that
is off by one step is wrong by a factor. Firmware is known to report the exposure of the picture before, sensors to take a setting over a
picture later than documented, other programs to change it, and lamps to be switched between two exposures. The first two shift all labels
alike, which is seen and corrected; of the others nothing is known but that the pictures do not belong together, and they are dropped.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from nearfield_server.capture.device import DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.capture.exposure_methods import (
    ExposureMethod,
    FreeRunning,
    MethodName,
    Sequencer,
    ShotDevice,
    SoftwareTrigger,
    choose_method,
)

RATIO_TOLERANCE: Final = 0.15
"""Relative error of a measured exposure ratio up to which labels count as right. Lamps on the mains flicker in short exposures, and light
may change a little while a bracket is taken; steps of exposure are factors of two and more."""
_ROUNDING: Final = 0.1
_CONSISTENT: Final = 3
_RECENT: Final = 20
_MOST_SETTLE_FRAMES: Final = 8


def find_shift(
    amounts: Sequence[float], ratios: Sequence[tuple[int, int, float]], likely: int = 0
) -> int | None:
    """Find by how many positions the labels of a cycle of exposures are off.

    Args:
        amounts: exposure amounts in the order in which they are taken, positive.
        ratios: (i, j, r): the picture labelled i shows r times the signal of that labelled j; NaN where too few pixels are valid in both.
        likely: tried first; where the pixels do not tell shifts apart, it is right.

    Returns:
        s: the picture labelled i was exposed by `amounts[(i - s) % n]`; 0 = labels are right, 1 = settings take effect a picture late,
        n - 1 = labels come a picture late. None: no shift explains the pictures.
    """
    known = [(i, j, r) for i, j, r in ratios if math.isfinite(r) and r > 0.0]
    count = len(amounts)
    order = sorted(range(count), key=lambda s: (s != likely, s != 0, min(s, count - s), s))
    limit = math.log1p(RATIO_TOLERANCE)
    for shift in order:
        if all(
            abs(math.log(r * amounts[(j - shift) % count] / amounts[(i - shift) % count])) <= limit
            for i, j, r in known
        ):
            return shift
    return None


@dataclass(frozen=True, slots=True)
class Bracket:
    """A complete bracket; the pictures are where `store` put them.

    Attributes:
        exposures: by position in the plan, labels corrected: of the picture that was stored there.
        frame_ids: likewise.
        device_ns: likewise, the device's time of the start of the exposure, or None.
        start_ns: CLOCK_MONOTONIC when the first exposure began.
        end_ns: when the last one ended.
    """

    exposures: tuple[Exposure, ...]
    frame_ids: tuple[int, ...]
    device_ns: tuple[int | None, ...]
    start_ns: int
    end_ns: int

    @property
    def middle_ns(self) -> int:
        """The time that the merged picture stands for."""
        return (self.start_ns + self.end_ns) // 2


@dataclass(slots=True)
class BracketCounters:
    """What became of the brackets.

    Attributes:
        complete: passed on.
        broken: given up because a picture was lost.
        inconsistent: dropped because the pictures do not fit the exposures.
        unverified: passed on although too few pixels were valid in two pictures to check the labels.
    """

    complete: int = 0
    broken: int = 0
    inconsistent: int = 0
    unverified: int = 0


@dataclass(frozen=True, slots=True)
class _Stored:
    """What is kept of a picture besides its pixels."""

    frame_id: int
    device_ns: int | None
    start_ns: int
    end_ns: int


class Bracketing:
    """Drives a device through a plan of exposures; one picture per `step`."""

    def __init__(
        self,
        device: ShotDevice,
        capabilities: DeviceCapabilities,
        *,
        store: Callable[[int, SensorFrame], tuple[int, int]],
        ratios: Callable[[], Sequence[tuple[int, int, float]]],
        clock: Callable[[], int],
        method: str = "auto",
        settle_frames: int | None = None,
        period_s: float = 0.0,
        is_free: bool = True,
    ) -> None:
        """Choose the method; nothing is set yet.

        Args:
            device: opened.
            capabilities: of the device.
            store: keeps the pixels of the picture at a position of the plan (the frame is released afterwards) and returns when its
                exposure began and ended, CLOCK_MONOTONIC ns.
            ratios: measured ratios of the signals of the pictures stored last, see `find_shift`; called once per complete bracket.
            clock: CLOCK_MONOTONIC, ns.
            method: of the room file.
            settle_frames: of the room file; None = as the device says.
            period_s: with a software trigger, the shortest time between the beginnings of two brackets.
            is_free: false where a hardware trigger leads the device.
        """
        self._device, self._store, self._ratios = device, store, ratios
        self._wanted = method
        self._plan: tuple[Exposure, ...] = ()
        name: MethodName = choose_method(method, capabilities)
        self.method: ExposureMethod
        if name == "sequencer":
            self.method = Sequencer(device, is_free=is_free)
        elif name == "software_trigger":
            self.method = SoftwareTrigger(device, clock, period_s)
        else:
            settle = capabilities.settle_frames if settle_frames is None else settle_frames
            self.method = FreeRunning(device, clock, settle, is_free=is_free)
        self.counters = BracketCounters()
        self._recent: deque[bool] = deque(maxlen=_RECENT)
        self._unverified: deque[bool] = deque(maxlen=_RECENT)
        self._shift = 0
        self._other_shifts: deque[int] = deque(maxlen=_CONSISTENT)
        self._words = ""
        self._shots: dict[int, _Stored] = {}

    @property
    def warnings(self) -> list[str]:
        """What a user should know, in words."""
        words = [self._words] if self._words else []
        if self._wanted not in ("auto", self.method.name):
            words.append(
                f'hdr.method "{self._wanted}" is more than this camera can do; "{self.method.name}" is used'
            )
        for asked, found in zip(self._plan, self.method.exposures, strict=False):
            if abs(found.amount - asked.amount) > _ROUNDING * asked.amount:
                words.append(
                    f"{asked.time_s:.3g} s at gain {asked.gain:.3g} was asked for, "
                    f"the camera exposes {found.time_s:.3g} s at gain {found.gain:.3g}"
                )
        dropped = len(self._recent) - sum(self._recent)
        if dropped > _RECENT // 4:
            words.append(
                f"{dropped} of the last {len(self._recent)} brackets were dropped because the pictures do not fit their exposures: "
                "light that flickers or changes fast, or another program changes the exposure"
            )
        if sum(self._unverified) > _RECENT // 2:
            words.append(
                "exposures cannot be checked, because hardly any pixel is well exposed in two of them: "
                "the room is too dark for the exposures, or they are too far apart"
            )
        return words

    def start(self, exposures: Sequence[Exposure]) -> None:
        """Begin with a plan: two or more exposures, in the order in which they are taken.

        Raises:
            CaptureError: from the device.
        """
        self._shots.clear()
        self._plan = tuple(exposures)
        self.method.start(exposures)

    def step(self, timeout_s: float) -> Bracket | None:
        """Wait for one picture, and return the bracket that it completes, if it does.

        Raises:
            CaptureError: from the device.
        """
        shot = self.method.shoot(timeout_s)
        if shot is None:
            return None
        try:
            if self._shots and (not shot.follows or shot.index in self._shots):
                self.counters.broken += 1
                self._shots.clear()
            start_ns, end_ns = self._store(shot.index, shot.frame)
            self._shots[shot.index] = _Stored(shot.frame.frame_id, shot.frame.device_ns, start_ns, end_ns)
        finally:
            self._device.release(shot.frame)
        if len(self._shots) < len(self.method.exposures):
            return None
        bracket = self._judge()
        self._shots.clear()
        return bracket

    def _judge(self) -> Bracket | None:
        amounts = [exposure.amount for exposure in self.method.exposures]
        ratios = list(self._ratios())
        shift = find_shift(amounts, ratios, likely=self._shift)
        is_good = shift == self._shift
        self._recent.append(is_good)
        if not is_good:
            self.counters.inconsistent += 1
            self._learn(shift)
            return None
        self._other_shifts.clear()
        self.counters.complete += 1
        is_unverified = not any(math.isfinite(r) for _, _, r in ratios)
        self._unverified.append(is_unverified)
        self.counters.unverified += is_unverified
        count = len(amounts)
        shots = [self._shots[index] for index in range(count)]
        return Bracket(
            tuple(self.method.exposures[(index - self._shift) % count] for index in range(count)),
            tuple(shot.frame_id for shot in shots),
            tuple(shot.device_ns for shot in shots),
            min(shot.start_ns for shot in shots),
            max(shot.end_ns for shot in shots),
        )

    def _learn(self, shift: int | None) -> None:
        """Correct the labels once the same shift was seen several times in a row."""
        if shift is None:
            self._other_shifts.clear()
            return
        self._other_shifts.append(shift)
        if len(self._other_shifts) < _CONSISTENT or len(set(self._other_shifts)) > 1:
            return
        self._other_shifts.clear()
        if isinstance(self.method, FreeRunning) and self.method.settle_frames < _MOST_SETTLE_FRAMES:
            self.method.settle_frames += 1
            self._words = (
                "exposures took effect later than settle_frames allows: "
                f"{self.method.settle_frames} pictures are now dropped after each change"
            )
            return
        self._shift = shift
        apart = min(shift, len(self.method.exposures) - shift)
        self._words = (
            f"exposures and their labels are {apart} picture{'s' if apart > 1 else ''} apart; corrected by the pixels"
            if shift
            else ""
        )
