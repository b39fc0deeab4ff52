"""The exposure of an opened camera: what the room file asks for, what the camera makes of it, and what it says of itself."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nearfield_server.capture.device import Exposure
from nearfield_server.capture.v4l2.controls import ControlSet, spell
from nearfield_server.capture.v4l2.exposure_control import (
    ExposureScale,
    GainScale,
    LineTiming,
    find_exposure_scale,
    find_gain_control,
    find_gain_scale,
)
from nearfield_server.capture.v4l2.kernel_api import ControlId
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import V4l2SourceTable


@dataclass(frozen=True, slots=True)
class ExposureSetting:
    """The controls that mean exposure time and gain, with their limits for the format and frame rate of now.

    Attributes:
        controls: of the camera.
        time: scale of the exposure time; None where it cannot be set.
        gain: scale of the gain; None where it cannot be set.
    """

    controls: ControlSet
    time: ExposureScale | None
    gain: GainScale | None

    def apply(self, wish: Exposure) -> Exposure:
        """Set exposure time and gain, clamped to what there is; returns what the camera has then.

        Raises:
            CaptureError: the camera refuses.
            OSError: it is gone.
        """
        time_s, gain = wish.time_s, wish.gain
        if self.time is not None:
            value = self.controls.set(self.time.control, self.time.value(time_s))
            time_s = self.time.seconds(value)
        if self.gain is not None:
            gain = self.gain.gain(self.controls.set(self.gain.control, self.gain.value(gain)))
        return Exposure(time_s=time_s, gain=gain)

    def read(self, last: Exposure) -> Exposure:
        """Return exposure time and gain of now; what cannot be read is as in `last`.

        Raises:
            OSError: the camera is gone.
        """
        return Exposure(
            time_s=self.time.seconds(self.controls.get(self.time.control)) if self.time else last.time_s,
            gain=self.gain.gain(self.controls.get(self.gain.control)) if self.gain else last.gain,
        )

    def first(self, table: V4l2SourceTable, frame_rate: float) -> tuple[Exposure, list[str]]:
        """Return the exposure to begin with, and warnings in words.

        Where the exposure cannot be set, it is as the room file says, else one frame. A gain control of unknown meaning is put to its
        least value here, so that it does not depend on who used the camera before.

        Args:
            table: what the room file asks for.
            frame_rate: frames per second.

        Raises:
            CaptureError: the room file asks for what the camera does not have; says what it has.
            OSError: the camera is gone.
        """
        gain = 10 ** (table.gain_db / 20)
        if self.gain is None:
            self._fix_gain(table)
        elif not _within(gain, self.gain.range):
            low, high = (20 * math.log10(limit) for limit in self.gain.range)
            raise CaptureError(f"gain_db: expected {low:.3g} to {high:.3g}, found {table.gain_db:g}")
        if self.time is None:
            time_s = table.exposure_s or 1.0 / frame_rate
            return Exposure(time_s=time_s, gain=gain), self._words_for_no_control(table)
        if table.exposure_s is None:
            default_s = self.time.seconds(self.time.value(self.time.seconds(self.time.control.default)))
            return Exposure(time_s=default_s, gain=gain), []
        low, high = self.time.range_s
        if not _within(table.exposure_s, (low, high), slack=0.5 * self.time.unit_s):
            raise CaptureError(
                f"exposure_s: expected {low:.6g} to {high:.6g} s, found {table.exposure_s:g} s"
            )
        return Exposure(time_s=table.exposure_s, gain=gain), []

    def _fix_gain(self, table: V4l2SourceTable) -> None:
        control = find_gain_control(self.controls)
        if table.gain_db != 0:
            what = (
                "the camera has no gain control" if control is None else f"nothing says what {control} means"
            )
            raise CaptureError(f"gain_db: expected 0, found {table.gain_db:g}: {what}; see gain_steps")
        if control is not None and control.name not in {spell(name) for name in table.controls}:
            self.controls.set(control, control.minimum)

    def _words_for_no_control(self, table: V4l2SourceTable) -> list[str]:
        lines = self.controls.find(ControlId.EXPOSURE)
        if lines is not None:
            return [
                f"the unit of control {lines} is not known, so the exposure cannot be set: give exposure_unit_s "
                "(seconds of one unit) in the room file"
            ]
        if table.exposure_s is None:
            return [
                "the camera has no exposure control: exposure_s in the room file should say how it exposes; "
                "one frame time is assumed"
            ]
        return []


def find_exposure_setting(
    controls: ControlSet, table: V4l2SourceTable, timing: LineTiming | None
) -> ExposureSetting:
    """Find the controls of a camera that mean exposure time and gain.

    Args:
        controls: read anew after format and frame rate were set.
        table: of the room file.
        timing: how the sensor is read, if the driver tells.
    """
    return ExposureSetting(
        controls,
        find_exposure_scale(controls, table.exposure_unit_s, timing),
        find_gain_scale(controls, table.gain_steps),
    )


def _within(value: float, limits: tuple[float, float], slack: float = 0.0) -> bool:
    low, high = limits
    return low * (1 - 1e-6) - slack <= value <= high * (1 + 1e-6) + slack
