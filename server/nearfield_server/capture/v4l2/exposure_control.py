"""Exposure time and gain in SI units, and the controls of a V4L2 camera that mean them.

V4L2 has two exposure controls: EXPOSURE_ABSOLUTE in units of 100 us (USB cameras), and EXPOSURE in units that the driver chooses, which
for bare sensors are lines; a line takes (width + horizontal blanking) / pixel rate, and drivers of sensors tell both. Gain controls have no
unit at all: `gain_steps` of the room file says what their values mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nearfield_server.capture.v4l2.controls import Control, ControlSet
from nearfield_server.capture.v4l2.kernel_api import ControlId

ABSOLUTE_UNIT_S = 1e-4


@dataclass(frozen=True, slots=True)
class LineTiming:
    """How a sensor is read.

    Attributes:
        pixel_rate: pixels per second.
        line_pixels: pixels of a line, blanking included.
    """

    pixel_rate: int
    line_pixels: int

    @property
    def line_s(self) -> float:
        """Time of a line, seconds."""
        return self.line_pixels / self.pixel_rate

    def blank_lines(self, height: int, frame_rate: float) -> float:
        """Vertical blanking that gives a frame rate."""
        return 1.0 / (frame_rate * self.line_s) - height


def read_line_timing(controls: ControlSet, width: int) -> LineTiming | None:
    """Return how the sensor is read, None where the driver does not tell.

    Args:
        controls: of the camera, with the format set.
        width: pixels that the sensor reads per line; right as long as it does not crop or scale.

    Raises:
        OSError: the device is gone.
    """
    rate, blank = controls.find(ControlId.PIXEL_RATE), controls.find(ControlId.HBLANK)
    if rate is None or blank is None:
        return None
    pixel_rate = controls.get(rate)
    return LineTiming(pixel_rate, width + controls.get(blank)) if pixel_rate > 0 else None


def set_blanking(controls: ControlSet, timing: LineTiming, height: int, frame_rate: float) -> float | None:
    """Set the frame rate of a bare sensor by its vertical blanking; returns the rate then, None where the driver does not tell.

    Args:
        controls: of the camera.
        timing: how the sensor is read.
        height: lines that it shows.
        frame_rate: frames per second.

    Raises:
        CaptureError: the camera refuses.
        OSError: it is gone.
    """
    blank = controls.find(ControlId.VBLANK)
    if blank is None:
        return None
    wanted = blank.nearest(timing.blank_lines(height, frame_rate))
    lines = controls.set(blank, wanted) if blank.can_be_set else controls.get(blank)
    return 1.0 / (timing.line_s * (height + lines))


@dataclass(frozen=True, slots=True)
class ExposureScale:
    """An exposure control and the time of one of its units.

    Attributes:
        control: the control, with its limits of now.
        unit_s: seconds.
    """

    control: Control
    unit_s: float

    @property
    def range_s(self) -> tuple[float, float]:
        """Shortest and longest time, seconds; zero is no exposure."""
        least = max(self.control.minimum, 1)
        return self.seconds(least), self.seconds(self.control.maximum)

    def seconds(self, value: int) -> float:
        """Return the time that a value means."""
        return value * self.unit_s

    def value(self, time_s: float) -> int:
        """Return the value nearest to a time, at least one unit."""
        found = self.control.nearest(time_s / self.unit_s)
        return found if found > 0 else found + max(1, self.control.step)


def find_exposure_scale(
    controls: ControlSet, unit_s: float | None, timing: LineTiming | None
) -> ExposureScale | None:
    """Return the control that sets the exposure time, None where there is none or its unit is not known.

    Args:
        controls: of the camera.
        unit_s: what the room file says about the unit; None = as V4L2 says.
        timing: how the sensor is read, if known.
    """
    absolute, lines = controls.find(ControlId.EXPOSURE_ABSOLUTE), controls.find(ControlId.EXPOSURE)
    if absolute is not None and absolute.can_be_set:
        return ExposureScale(absolute, unit_s or ABSOLUTE_UNIT_S)
    if lines is not None and lines.can_be_set:
        unit = unit_s or (timing.line_s if timing else None)
        return ExposureScale(lines, unit) if unit else None
    return None


@dataclass(frozen=True, slots=True)
class GainScale:
    """A gain control and what its values mean.

    Attributes:
        control: the control.
        values: of the control, ascending. decibels: what they mean, ascending; linear between the points.
    """

    control: Control
    values: tuple[int, ...]
    decibels: tuple[float, ...]

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest linear gain that the control reaches within the known values."""
        least = max(self.control.minimum, self.values[0])
        return self.gain(least), self.gain(max(least, min(self.control.maximum, self.values[-1])))

    def gain(self, value: int) -> float:
        """Return the linear gain of a value."""
        return float(10 ** (np.interp(value, self.values, self.decibels) / 20))

    def value(self, gain: float) -> int:
        """Return the value nearest to a linear gain, within the known values."""
        decibels = 20 * math.log10(max(gain, 1e-6))
        wanted = float(np.interp(decibels, self.decibels, self.values))
        return self.control.nearest(min(max(wanted, self.values[0]), self.values[-1]))


def find_gain_control(controls: ControlSet) -> Control | None:
    """Return the control that amplifies the sensor's signal: the analogue gain where there is one."""
    for number in (ControlId.ANALOGUE_GAIN, ControlId.GAIN):
        control = controls.find(number)
        if control is not None and control.can_be_set:
            return control
    return None


def find_gain_scale(controls: ControlSet, steps: Sequence[tuple[int, float]]) -> GainScale | None:
    """Return the gain control with its meaning, None where there is none or nothing is known about it."""
    control = find_gain_control(controls)
    if control is None or not steps:
        return None
    return GainScale(control, tuple(value for value, _ in steps), tuple(decibels for _, decibels in steps))
