"""From a device's pictures to radiance: `imaging` for whatever format comes, with the choice of exposures for automatic brackets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.device import DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.errors import CaptureError, ConfigError
from nearfield_server.imaging.bracket_plan import (
    BracketLimits,
    BracketPlan,
    first_bracket,
    plan_bracket,
    radiance_histogram,
)
from nearfield_server.imaging.development import Developer
from nearfield_server.scene.device_schema import BracketTable, DeviceSourceTable

LONGEST_S: Final = 0.05
SHORTEST_S: Final = 5e-5
"""Between these an automatic bracket chooses where the room file sets no limits, seconds."""


class Darkroom:
    """Develops the pictures of one camera; see `device_source.PictureMaker`."""

    def __init__(
        self,
        camera_id: str,
        table: DeviceSourceTable,
        width: int,
        height: int,
        circle: NDArray[np.bool_] | None = None,
    ) -> None:
        """Nothing is known of the pixel format before the first picture.

        Args:
            camera_id: name for messages.
            table: of the room file.
            width: pixels expected.
            height: pixels expected.
            circle: (H, W) bool, where the lens shows anything: what lies outside asks for no exposure. None = everywhere.
        """
        self._camera_id, self._table, self._circle = camera_id, table, circle
        self._width, self._height = width, height
        self._developer: Developer | None = None
        self._merged: NDArray[np.float16] | None = None
        self._limits: BracketLimits | None = None
        self._asked, self._gain = 0, 1.0
        self.pixel_format = ""

    def develop(self, frame: SensorFrame, exposure: Exposure, out: NDArray[np.float16]) -> int:
        """Write the radiance of one picture to `out` (H, W, 4); returns the number of pixels that are only lower bounds.

        Raises:
            CaptureError: the picture is not what the room file says.
        """
        developer = self._developer_for(frame)
        developer.develop(frame.data, frame.row_bytes, exposure.amount, out)
        return developer.saturated

    def store(self, index: int, frame: SensorFrame) -> None:
        """Keep the codes of picture `index` of a bracket.

        Raises:
            CaptureError: the picture is not what the room file says.
        """
        self._developer_for(frame).keep(index, frame.data, frame.row_bytes)

    def ratios(self, exposures: Sequence[Exposure]) -> list[tuple[int, int, float]]:
        """Measured ratios of the stored pictures, see `bracketing.find_shift`."""
        return self._developed().ratios(len(exposures))

    def merge(self, exposures: Sequence[Exposure], out: NDArray[np.float16]) -> int:
        """Write the radiance of the stored pictures to `out`; returns the number of pixels that are only lower bounds."""
        developer = self._developed()
        developer.merge([exposure.amount for exposure in exposures], out)
        self._merged = out
        return developer.saturated

    def first_plan(
        self, table: BracketTable, capabilities: DeviceCapabilities, gain: float
    ) -> tuple[Exposure, ...]:
        """Exposures to begin with: those of the room file, else all that room file and device allow.

        Raises:
            CaptureError: the exposures of the device cannot be chosen within these limits.
        """
        least_s, greatest_s = capabilities.exposure_range_s
        self._limits, self._asked, self._gain = None, 0, gain
        if table.exposures_s:
            times_s = table.exposures_s
        else:
            longest_s = min(table.longest_s or LONGEST_S, greatest_s)
            shortest_s = max(table.shortest_s or SHORTEST_S, least_s)
            if shortest_s >= longest_s:
                raise CaptureError(
                    f"camera {self._camera_id}: exposures can be set from {least_s:g} s to {greatest_s:g} s, and the room file "
                    f"asks for a bracket from {shortest_s:g} s to {longest_s:g} s; expected a range, so change hdr.shortest_s or longest_s"
                )
            self._limits = BracketLimits(
                shortest=shortest_s * gain,
                longest=longest_s * gain,
                num_exposures=table.num_exposures,
                full_radiance=self._table.radiance_per_code,
            )
            times_s = tuple(amount / gain for amount in first_bracket(self._limits).amounts)
        return tuple(Exposure(time_s=min(max(time_s, least_s), greatest_s), gain=gain) for time_s in times_s)

    def next_plan(self, exposures: Sequence[Exposure]) -> tuple[Exposure, ...] | None:
        """Better exposures for what was merged last; None = those in use are good enough, or are given."""
        if self._limits is None or self._merged is None:
            return None
        present = BracketPlan(amounts=tuple(exposure.amount for exposure in exposures), asked=self._asked)
        better = plan_bracket(radiance_histogram(self._merged, self._circle), present, self._limits)
        self._asked = better.asked
        if better.amounts == present.amounts:
            return None
        return tuple(Exposure(time_s=amount / self._gain, gain=self._gain) for amount in better.amounts)

    def _developed(self) -> Developer:
        if self._developer is None:
            raise CaptureError(f"camera {self._camera_id}: no picture has been stored")
        return self._developer

    def _developer_for(self, frame: SensorFrame) -> Developer:
        if (frame.width, frame.height) != (self._width, self._height):
            raise CaptureError(
                f"camera {self._camera_id} delivers {frame.width} x {frame.height} pixels, "
                f"expected {self._width} x {self._height} as in the room file; calibrate it anew, or set its region"
            )
        if self._developer is None or frame.pixel_format != self.pixel_format:
            try:
                self._developer = Developer(self._table, frame.pixel_format, self._width, self._height)
            except (CaptureError, ConfigError) as error:
                raise CaptureError(f"camera {self._camera_id}: {error}") from error
            self.pixel_format = frame.pixel_format
        return self._developer
