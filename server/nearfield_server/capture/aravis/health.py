"""What a camera tells of its well-being: temperature, and the synchronisation of its clock. Read seldom, and only while it answers."""

from __future__ import annotations

import math
from typing import Final

from nearfield_server.capture.aravis.features import Features
from nearfield_server.capture.aravis.library import AravisError
from nearfield_server.errors import CaptureError

_PTP_NAMES: Final = (  # enable, latch, status, offset: SFNC 2, then the names of older cameras
    ("PtpEnable", "PtpDataSetLatch", "PtpStatus", "PtpOffsetFromMaster"),
    (
        "GevIEEE1588",
        "GevIEEE1588DataSetLatch",
        "GevIEEE1588StatusLatched",
        "GevIEEE1588OffsetFromMaster",
    ),
    ("GevIEEE1588", "GevIEEE1588DataSetLatch", "GevIEEE1588Status", "GevIEEE1588OffsetFromMaster"),
)


class Health:
    """Reads what a device offers; what it does not offer, or fails to tell, is left out."""

    def __init__(self, features: Features) -> None:
        self._features = features
        self._temperature = features.first("DeviceTemperature", "DeviceTemperatureRaw", "TemperatureAbs")
        if self._temperature == "DeviceTemperatureRaw":  # of unknown unit
            self._temperature = None
        self._ptp = next(
            (names for names in _PTP_NAMES if features.has(names[0]) and features.has(names[2])), None
        )

    def read(self) -> dict[str, str | int | float | bool]:
        """`temperature_c`, `ptp_status`, `ptp_offset_ns`.

        Raises:
            AravisError: the camera does not answer.
        """
        found: dict[str, str | int | float | bool] = {}
        try:
            if self._temperature is not None:
                celsius = self._features.number(self._temperature)
                if -100.0 <= celsius <= 300.0:
                    found["temperature_c"] = round(celsius, 1)
            if self._ptp is not None:
                found.update(self._read_ptp(*self._ptp))
        except AravisError as error:
            if error.is_timeout:
                raise
        except CaptureError:
            pass  # broken numbers are as good as none
        return found

    def _read_ptp(self, enable: str, latch: str, status: str, offset: str) -> dict[str, str | int]:
        if not self._features.number(enable):
            return {}
        if self._features.kind(latch) == "command":
            self._features.execute(latch)
        found: dict[str, str | int] = {"ptp_status": self._features.text(status)}
        if self._features.has(offset):
            nanoseconds = self._features.number(offset)
            if math.isfinite(nanoseconds):
                found["ptp_offset_ns"] = int(nanoseconds)
        return found
