"""A real camera as a `Source`: takes exposures, dates them, turns codes into radiance, and says in words what is wrong.

The newest picture wins: what waited while the one before was developed is given back unseen. With a bracket every picture counts.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.bracketing import Bracket, Bracketing
from nearfield_server.capture.device import Device, DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.capture.exposure_methods import SoftwareTrigger
from nearfield_server.capture.frame_stream import FrameStream
from nearfield_server.capture.picture_watch import FrozenWatch, exposure_differs
from nearfield_server.capture.source import RawFrame
from nearfield_server.errors import CaptureError
from nearfield_server.imaging.development import compile_kernels
from nearfield_server.scene.device_schema import AravisSourceTable, BracketTable, DeviceSourceTable

_SLICE_S: Final = 0.05
_WAIT_S: Final = 0.1
_STATISTICS_PERIOD_S: Final = 0.5
_READBACK_PERIOD_S: Final = 0.25
_JUDGE_PERIOD_S: Final = 1.0
_WARNED_FOR_S: Final = 10.0
_FROZEN_LIMIT_S: Final = 5.0
_BLACK: Final = 0.004
"""Share of the range of the longest exposure below which everything is black: less than two of 255 codes."""
_SATURATED_SHARE: Final = 0.02
_SATURATED_BRACKET_SHARE: Final = 0.002


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceCamera:
    """What a device source is made from.

    Attributes:
        camera_id: name for messages.
        table: the `source` table of the room file.
        height: pixels expected. width: pixels expected.
        frame_rate: pictures per second asked of the device (brackets per second where it can be triggered).
    """

    camera_id: str
    table: DeviceSourceTable
    height: int
    width: int
    frame_rate: float


class PictureMaker(Protocol):
    """Codes to radiance; `darkroom.Darkroom` is the one in use.

    All methods raise CaptureError where a picture is not what the room file says.
    """

    @property
    def pixel_format(self) -> str:
        """Of the last picture; empty before the first one."""

    def develop(self, frame: SensorFrame, exposure: Exposure, out: NDArray[np.float16]) -> int:
        """Write the radiance of one picture to `out` (H, W, 4); returns the number of saturated pixels."""

    def store(self, index: int, frame: SensorFrame) -> None:
        """Keep a copy of the codes as picture `index` of a bracket."""

    def ratios(self, exposures: Sequence[Exposure]) -> list[tuple[int, int, float]]:
        """Measured ratios of the signals of the stored pictures, see `bracketing.find_shift`."""

    def merge(self, exposures: Sequence[Exposure], out: NDArray[np.float16]) -> int:
        """Write the radiance of the stored pictures to `out`; returns the number of pixels saturated in all of them."""

    def first_plan(
        self, table: BracketTable, capabilities: DeviceCapabilities, gain: float
    ) -> tuple[Exposure, ...]:
        """Exposures to begin with."""

    def next_plan(self, exposures: Sequence[Exposure]) -> tuple[Exposure, ...] | None:
        """Better exposures for what was merged last; None = those in use are fine, or are given."""


class DeviceSource:
    """`Source` of a `Device`."""

    def __init__(
        self,
        camera: DeviceCamera,
        device: Device,
        darkroom: PictureMaker,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Keep the device; nothing is opened.

        Args:
            camera: what is expected of it.
            device: belongs to this source from now on.
            darkroom: for pictures of this camera.
            clock: CLOCK_MONOTONIC, ns.
        """
        self._camera, self._device, self._darkroom, self._clock = camera, device, darkroom, clock
        self._stream = FrameStream(device, camera.camera_id, clock, 1.0 / camera.frame_rate)
        self._picture = np.zeros((camera.height, camera.width, 4), np.float16)
        self._watch = FrozenWatch()
        self._frozen_since_ns: int | None = None
        self._is_open = False
        self._opened = 0
        self._revision = 0
        self._timestamp_ns = 0
        self._skipped = 0
        self._saturated_share: float | None = None
        self._warnings: dict[str, tuple[str, int]] = {}
        self._statistics: dict[str, Any] = {}
        self._statistics_ns = self._readback_ns = self._judged_ns = 0
        self._exposures: tuple[Exposure, ...] = ()
        self._trigger: SoftwareTrigger | None = None
        self._bracketing: Bracketing | None = None
        self._waiting: tuple[SensorFrame, tuple[int, int]] | None = None
        self._bracket: Bracket | None = None
        self._bracket_period_s: float | None = None
        self._last_bracket_ns: int | None = None

    def open(self) -> None:
        """Open the device with all its settings, and begin to take pictures.

        Raises:
            CaptureError: in words, from the device.
        """
        compile_kernels()
        capabilities = self._stream.open()
        self._is_open = True
        self._waiting, self._bracket, self._last_bracket_ns = None, None, None
        self._watch.restart()
        self._frozen_since_ns = None
        self._refresh_statistics(self._clock())
        table = self._camera.table
        self._stream.forget_exposures()
        self._trigger, self._bracketing = None, None
        if isinstance(table.hdr, BracketTable):
            self._start_bracketing(table.hdr, capabilities)
        else:
            self._start_single(capabilities)
        self._opened += 1

    def _start_single(self, capabilities: DeviceCapabilities) -> None:
        commanded = self._stream.read_exposure()
        self._stream.longest_exposure_s = commanded.time_s
        self._exposures = (commanded,)
        if _trigger_of(self._camera.table) == "software":
            if not capabilities.software_trigger:
                raise CaptureError(
                    f'camera {self._camera.camera_id}: trigger = "software", but this camera has no software trigger; use "free"'
                )
            self._trigger = SoftwareTrigger(self._stream, self._clock, 1.0 / self._camera.frame_rate)
            self._trigger.start(self._exposures)

    def _start_bracketing(self, table: BracketTable, capabilities: DeviceCapabilities) -> None:
        is_free = _trigger_of(self._camera.table) != "hardware"
        if not is_free:
            capabilities = replace(capabilities, software_trigger=False)
        gain = 10.0 ** (self._camera.table.gain_db / 20.0)
        self._exposures = self._darkroom.first_plan(table, capabilities, gain)
        self._bracketing = Bracketing(
            self._stream,
            capabilities,
            store=self._store,
            ratios=self._measured_ratios,
            clock=self._clock,
            method=table.method,
            settle_frames=table.settle_frames,
            period_s=1.0 / self._camera.frame_rate,
            is_free=is_free,
        )
        self._bracketing.start(self._exposures)

    def close(self) -> None:
        """Give the device back."""
        self._is_open = False
        self._waiting, self._bracket = None, None
        self._stream.close()

    def set_light_weights(self, weights: tuple[float, ...]) -> None:
        """Ignore the switchable lights: the camera sees the room as it is."""

    def wait_for_frame(self, stop: threading.Event, period_s: float) -> None:
        """Wait for a picture or a whole bracket, at most about a tenth of a second.

        Raises:
            CaptureError: the device is gone or silent.
        """
        end_ns = self._clock() + round(_WAIT_S * 1e9)
        while not stop.is_set() and self._clock() < end_ns and not self._has_news():
            remaining_s = min(_SLICE_S, (end_ns - self._clock()) * 1e-9)
            if self._bracketing is not None:
                self._bracket = self._bracketing.step(remaining_s)
            else:
                self._take(remaining_s)

    def _has_news(self) -> bool:
        return self._waiting is not None or self._bracket is not None

    def _take(self, timeout_s: float) -> None:
        """Take a picture if one comes; the newest wins."""
        if self._trigger is not None:
            shot = self._trigger.shoot(timeout_s)
            frame = None if shot is None else shot.frame
        else:
            frame = self._stream.next_frame(timeout_s)
        while frame is not None:
            if self._waiting is not None:
                self._stream.release(self._waiting[0])
                self._skipped += 1
            self._waiting = (frame, self._stream.exposed_ns)
            frame = None if self._trigger is not None else self._stream.next_frame(0.0)

    def next_frame(self, now_ns: int) -> RawFrame | None:
        """Develop what waits.

        Raises:
            CaptureError: the device is gone or silent, or delivers something else than the room file says.
        """
        if not self._is_open:
            raise CaptureError(f"camera {self._camera.camera_id}: next_frame before open")
        now_ns = self._clock()
        if now_ns - self._statistics_ns >= _STATISTICS_PERIOD_S * 1e9:
            self._refresh_statistics(now_ns)
        if self._bracketing is None:
            self._take(0.0)
        if self._waiting is not None:
            return self._develop(now_ns)
        if self._bracket is not None:
            return self._merge(now_ns)
        return None

    def _develop(self, now_ns: int) -> RawFrame | None:
        assert self._waiting is not None
        frame, (start_ns, end_ns) = self._waiting
        self._waiting = None
        try:
            exposure = self._true_exposure(frame, now_ns)
            self._watch.observe(0, frame.data, now_ns)
            saturated = self._darkroom.develop(frame, exposure, self._picture)
            metadata = self._metadata((exposure,), (frame.frame_id,), (frame.device_ns,), start_ns, end_ns)
        finally:
            self._stream.release(frame)
        return self._finished(saturated, (start_ns + end_ns) // 2, metadata, (exposure,), now_ns)

    def _merge(self, now_ns: int) -> RawFrame | None:
        bracket = self._bracket
        assert bracket is not None
        assert self._bracketing is not None
        self._bracket = None
        saturated = self._darkroom.merge(bracket.exposures, self._picture)
        metadata = self._metadata(
            bracket.exposures, bracket.frame_ids, bracket.device_ns, bracket.start_ns, bracket.end_ns
        )
        self._note_bracket_rate(bracket.middle_ns)
        frame = self._finished(saturated, bracket.middle_ns, metadata, bracket.exposures, now_ns)
        plan = self._darkroom.next_plan(bracket.exposures)
        if plan is not None:
            self._exposures = plan
            self._stream.forget_exposures()
            self._bracketing.start(plan)
        return frame

    def _store(self, index: int, frame: SensorFrame) -> tuple[int, int]:
        self._watch.observe(index, frame.data, self._clock())
        self._darkroom.store(index, frame)
        return self._stream.exposed_ns

    def _measured_ratios(self) -> list[tuple[int, int, float]]:
        assert self._bracketing is not None
        return self._darkroom.ratios(self._bracketing.method.exposures)

    def _true_exposure(self, frame: SensorFrame, now_ns: int) -> Exposure:
        """The exposure of a single picture: its label, else what the device says of itself; what someone else changed is set again."""
        commanded = self._exposures[0]
        if frame.is_labelled:
            found = frame.exposure
        elif now_ns - self._readback_ns >= _READBACK_PERIOD_S * 1e9:
            self._readback_ns = now_ns
            found = self._stream.read_exposure()
        else:
            return commanded
        if not exposure_differs(commanded.amount, found.amount):
            return found if frame.is_labelled else commanded
        self._warn(
            "exposure",
            f"the exposure was changed by someone else to {found.time_s:.3g} s at gain {found.gain:.3g}; "
            f"{commanded.time_s:.3g} s at gain {commanded.gain:.3g} is set again",
            now_ns,
        )
        self._exposures = (self._stream.set_exposure(commanded),)
        return found

    def _finished(
        self,
        saturated: int,
        middle_ns: int,
        metadata: dict[str, Any],
        exposures: tuple[Exposure, ...],
        now_ns: int,
    ) -> RawFrame | None:
        if self._is_withheld(now_ns):
            return None
        self._saturated_share = saturated / (self._camera.height * self._camera.width)
        if now_ns - self._judged_ns >= _JUDGE_PERIOD_S * 1e9:
            self._judged_ns = now_ns
            self._judge_picture(exposures, now_ns)
        self._revision += 1
        # Readers rely on ascending times, whatever the device's clock does.
        self._timestamp_ns = max(middle_ns, self._timestamp_ns + 1)
        return RawFrame(
            pixels=self._picture,
            timestamp_ns=self._timestamp_ns,
            content_revision=self._revision,
            counters={"saturated": saturated},
            metadata=metadata,
        )

    def _is_withheld(self, now_ns: int) -> bool:
        """A frozen picture is not passed on: its age grows, as that of a dead camera's. After some seconds the device is opened again."""
        if not self._watch.is_frozen(now_ns):
            self._frozen_since_ns = None
            return False
        self._frozen_since_ns = self._frozen_since_ns or now_ns
        self._warn("frozen", "the camera sends the same picture again and again: it hangs", now_ns)
        if now_ns - self._frozen_since_ns >= _FROZEN_LIMIT_S * 1e9:
            raise CaptureError(
                f"camera {self._camera.camera_id}: its picture has been frozen, bit for bit, for more than {_FROZEN_LIMIT_S:.0f} s; "
                "it is opened again. If that does not help, cut its power for a moment"
            )
        return True

    def _judge_picture(self, exposures: tuple[Exposure, ...], now_ns: int) -> None:
        longest = max(exposure.amount for exposure in exposures)
        full = self._camera.table.radiance_per_code / longest
        if float(self._picture[..., :3].max(initial=0.0)) < _BLACK * full:
            self._warn(
                "black",
                f"the picture is black at {longest:.3g} s: lens cap, aperture, black_level, or a dark room",
                now_ns,
            )
        share = self._saturated_share or 0.0
        if self._bracketing is None and share > _SATURATED_SHARE:
            self._warn(
                "saturated",
                f"{100 * share:.1f} % of the pixels are saturated, their light is a lower bound: "
                'shorten exposure_s, or use hdr = { mode = "bracket" }',
                now_ns,
            )
        elif self._bracketing is not None and share > _SATURATED_BRACKET_SHARE:
            self._warn(
                "saturated",
                f"{100 * share:.1f} % of the pixels are saturated even at {min(e.time_s for e in exposures):.3g} s, "
                "their light is a lower bound: add a shorter exposure, close the aperture, or add a grey filter",
                now_ns,
            )

    def _warn(self, kind: str, words: str, now_ns: int) -> None:
        self._warnings[kind] = (words, now_ns)

    def _note_bracket_rate(self, middle_ns: int) -> None:
        if self._last_bracket_ns is not None:
            period_s = (middle_ns - self._last_bracket_ns) * 1e-9
            before = period_s if self._bracket_period_s is None else self._bracket_period_s
            self._bracket_period_s = before + 0.2 * (period_s - before)
        self._last_bracket_ns = middle_ns

    def _metadata(
        self,
        exposures: tuple[Exposure, ...],
        frame_ids: tuple[int, ...],
        device_ns: tuple[int | None, ...],
        start_ns: int,
        end_ns: int,
    ) -> dict[str, Any]:
        return {
            "exposures_s": [exposure.time_s for exposure in exposures],
            "gains": [exposure.gain for exposure in exposures],
            "frame_ids": list(frame_ids),
            "device_ns": [None if each is None else str(each) for each in device_ns],
            "exposed_from_ns": str(start_ns),
            "exposed_until_ns": str(end_ns),
            "clock": self._stream.clock_name,
            "pixel_format": self._darkroom.pixel_format,
        }

    def _refresh_statistics(self, now_ns: int) -> None:
        self._statistics_ns = now_ns
        self._statistics = dict(self._device.statistics())
        self._stream.use_statistics(self._statistics)

    def describe(self) -> dict[str, Any]:
        """Describe the camera for the status page; see the keys in the code."""
        now_ns = self._clock()
        statistics = {key: value for key, value in self._statistics.items() if key != "warnings"}
        stream, bracketing = self._stream, self._bracketing
        exposures = self._exposures if bracketing is None else bracketing.method.exposures
        described: dict[str, Any] = {
            "kind": self._camera.table.kind,
            "frames_lost": stream.gaps,
            "frames_broken": 0,
            **statistics,
            "pixel_format": self._darkroom.pixel_format,
            "exposure_s": [exposure.time_s for exposure in exposures],
            "gain": exposures[0].gain if exposures else None,
            "saturated_share": None if self._saturated_share is None else round(self._saturated_share, 6),
            "frames_taken": stream.frames,
            "frames_skipped": self._skipped,
            "reconnects": max(0, self._opened - 1),
            "clock_source": stream.clock_name,
            "clock_jumps": stream.clock_map.jumps,
            "warnings": self._words(now_ns),
        }
        if stream.clock_name == "fit":
            described["clock_skew_ppm"] = round(stream.clock_map.skew_ppm, 2)
        if bracketing is not None:
            counters = bracketing.counters
            described |= {
                "hdr_method": bracketing.method.name,
                "brackets": counters.complete,
                "brackets_broken": counters.broken,
                "brackets_inconsistent": counters.inconsistent,
                "brackets_unverified": counters.unverified,
                "frames_unused": bracketing.method.frames_unused,
                "bracket_rate": None
                if not self._bracket_period_s
                else round(1.0 / self._bracket_period_s, 2),
            }
        return described

    def _words(self, now_ns: int) -> list[str]:
        """All warnings that hold, in words; those of the picture as long as they were renewed."""
        from_device = str(self._statistics.get("warnings", "")).splitlines()
        from_bracketing = [] if self._bracketing is None else self._bracketing.warnings
        recent = [
            words for words, since_ns in self._warnings.values() if now_ns - since_ns < _WARNED_FOR_S * 1e9
        ]
        return [*from_device, *from_bracketing, *recent]


def pictures_per_second(table: DeviceSourceTable, frame_rate: float) -> float:
    """Return the rate to ask of a device so that it makes `frame_rate` pictures or whole brackets per second, if it can."""
    if not isinstance(table.hdr, BracketTable):
        return frame_rate
    return frame_rate * (len(table.hdr.exposures_s) or table.hdr.num_exposures)


def _trigger_of(table: DeviceSourceTable) -> str:
    return table.trigger if isinstance(table, AravisSourceTable) else "free"
