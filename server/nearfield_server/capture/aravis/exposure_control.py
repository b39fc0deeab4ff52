"""Exposure time and gain of a camera, whatever it calls them: SFNC (ExposureTime, Gain) or the older names of GigE Vision 1."""

from __future__ import annotations

import math
from typing import Final

from nearfield_server.capture.aravis.features import Features
from nearfield_server.capture.aravis.library import AravisError
from nearfield_server.capture.device import Exposure
from nearfield_server.errors import CaptureError

_AUTOMATICS: Final = ("ExposureAuto", "GainAuto", "BlackLevelAuto", "BalanceWhiteAuto", "GammaAuto")
_LONGEST_S: Final = 3600.0
_MOST_GAIN_DB: Final = 120.0


def linear_gain(decibels: float) -> float:
    """Factor on the signal; 20 dB are a factor of 10."""
    return float(10.0 ** (decibels / 20.0))


def decibels(gain: float) -> float:
    """The reverse of `linear_gain`; raises ValueError for factors that are not positive."""
    return 20.0 * math.log10(gain)


class ExposureControl:
    """Sets and reads the exposure of an opened device.

    `ExposureTime` and `ExposureTimeAbs` are microseconds. `Gain` and `GainAbs` are decibels. `GainRaw` has a unit that only the camera's
    manual tells, so it counts as gain 1, and is left as it is.

    Args:
        features: of the device.
        where: names the camera in messages.

    Raises:
        CaptureError: the ranges that the camera names are none.
    """

    def __init__(self, features: Features, where: str) -> None:
        self._features, self._where = features, where
        self._time = features.first("ExposureTime", "ExposureTimeAbs")
        gain = features.first("Gain", "GainAbs")
        self._gain = gain if gain is not None and features.kind(gain) == "float" else None
        self.read_ranges()

    def read_ranges(self) -> None:
        """Read `range_s` (seconds) and `gain_range` (factors) anew: they follow other settings."""
        self.range_s = self._time_range()
        self.gain_range = self._gain_range()

    def switch_automatics_off(self) -> None:
        """Let nothing but us change the exposure, and let codes stay proportional to light: automatics off, gamma off."""
        for name in _AUTOMATICS:
            self._features.set_if_possible(name, "Off")
        self._features.set_if_possible("ExposureMode", "Timed")
        if not self._features.set_if_possible("GammaEnable", False):
            self._features.set_if_possible("Gamma", 1.0)

    def running_automatics(self) -> tuple[str, ...]:
        """The automatics that would change the exposure behind our back."""
        return tuple(
            name
            for name in _AUTOMATICS[:2]
            if self._features.has(name) and self._features.text(name) != "Off"
        )

    def set(self, exposure: Exposure) -> Exposure:
        """Set exposure time and gain as near as the device can; returns what it made of them.

        Raises:
            CaptureError: the camera refuses, has no gain to set, or does not answer.
        """
        if self._time is not None:
            self._features.set_clamped(self._time, exposure.time_s * 1e6)
        if self._gain is not None:
            self._features.set_clamped(self._gain, decibels(exposure.gain))
        elif abs(exposure.gain - 1.0) > 1e-6:
            raise CaptureError(
                f"{self._where} has no gain in decibels; expected gain_db = 0, found {decibels(exposure.gain):.1f} "
                "(a GainRaw can be set by features)"
            )
        return self.read()

    def read(self) -> Exposure:
        """Ask the device how it exposes now.

        Raises:
            CaptureError: it names an exposure that cannot be, or does not answer.
        """
        time_s = 1.0 if self._time is None else self._features.number(self._time) * 1e-6
        gain_db = 0.0 if self._gain is None else self._features.number(self._gain)
        exposure = checked_exposure(time_s, gain_db)
        if exposure is None:
            raise CaptureError(f"{self._where}: it says that it exposes for {time_s} s at {gain_db} dB")
        return exposure

    def _time_range(self) -> tuple[float, float]:
        if self._time is None:
            return (1.0, 1.0)
        least, greatest = (value * 1e-6 for value in self._features.range(self._time))
        least, greatest = max(least, 1e-9), min(greatest, _LONGEST_S)
        if least > greatest:
            raise CaptureError(
                f"{self._where}: expected a range of exposure times, found {least} to {greatest} s"
            )
        return least, greatest

    def _gain_range(self) -> tuple[float, float]:
        if self._gain is None:
            return (1.0, 1.0)
        try:
            least, greatest = self._features.range(self._gain)
        except AravisError as error:
            if error.is_timeout:
                raise
            return (1.0, 1.0)
        return linear_gain(max(least, -_MOST_GAIN_DB)), linear_gain(min(greatest, _MOST_GAIN_DB))


def checked_exposure(time_s: float, gain_db: float) -> Exposure | None:
    """An exposure from numbers that a camera told; None if they cannot be true."""
    if not (0.0 < time_s <= _LONGEST_S and -_MOST_GAIN_DB <= gain_db <= _MOST_GAIN_DB):  # also false for NaN
        return None
    return Exposure(time_s=time_s, gain=linear_gain(gain_db))
