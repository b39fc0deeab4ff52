"""The pictures of an opened device with the time of this machine, counted, and watched for silence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from nearfield_server.capture.clock_map import ClockMap, shared_clock_offset
from nearfield_server.capture.device import Device, DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.errors import CaptureError

FIRST_FRAME_S: Final = 3.0
"""Streams take a moment to start."""
LEAST_FIRST_FRAME_S: Final = 1.0
_START_MARGIN: Final = 3.0
"""Once it is known how long a device takes to start, it has so many times that."""
_LEAST_LIMIT_S: Final = 0.5
_GREATEST_LIMIT_S: Final = 1.5
_LIMIT_PERIODS: Final = 5.0
_SLICE_S: Final = 0.1


def silence_limit_s(period_s: float, exposure_s: float = 0.0, least_periods: float = 2.0) -> float:
    """Return after which time without a picture a device counts as silent.

    Args:
        period_s: between two pictures.
        exposure_s: the longest exposure; pictures cannot come faster.
        least_periods: it is never less than so many periods or exposures.

    Returns:
        Five periods, at least 0.5 s and at most 1.5 s; but never less than `least_periods`.
    """
    slowest_s = max(period_s, exposure_s)
    return max(
        min(max(_LIMIT_PERIODS * period_s, _LEAST_LIMIT_S), _GREATEST_LIMIT_S), least_periods * slowest_s
    )


class FrameStream:
    """A `Device` from `open` to `close`, seen through one pair of eyes: every picture passes here, whoever asks for it.

    Attributes:
        exposed_ns: (start, end) of the exposure of the picture returned last, CLOCK_MONOTONIC.
        frames: pictures returned since the device was made.
        gaps: pictures missing in between, by their numbers.
        clock_name: where times come from: "host" (the device keeps this machine's time), "ptp" (a synchronised clock that this machine
            keeps too), "fit" (`ClockMap`) or "arrival" (no device clock).
    """

    def __init__(
        self, device: Device, camera_id: str, clock: Callable[[], int], period_s: float = 1.0 / 30.0
    ) -> None:
        """Keep the device; nothing is opened.

        Args:
            device: the device.
            camera_id: name for messages.
            clock: CLOCK_MONOTONIC, ns.
            period_s: between two pictures.
        """
        self._device, self._camera_id, self._clock, self._period_s = device, camera_id, clock, period_s
        self.clock_map = ClockMap()
        self.exposed_ns = (0, 0)
        self.frames = 0
        self.gaps = 0
        self.clock_name = "arrival"
        self.longest_exposure_s = 0.0
        self._last_id: int | None = None
        self._alive_ns = 0
        self._has_delivered = False
        self._opened_ns = 0
        self._start_limit_s = FIRST_FRAME_S
        self._synchronised = False
        self._is_host_clock = False
        self._is_triggered = False

    def open(self) -> DeviceCapabilities:
        """Open the device; its clock and its numbers begin anew."""
        capabilities = self._device.open()
        if not self._has_delivered:
            # It was opened in vain before, perhaps because it had too little time.
            self._start_limit_s = FIRST_FRAME_S
        self.clock_map.restart()
        self._last_id, self._has_delivered, self._is_triggered = None, False, False
        self._alive_ns = self._opened_ns = self._clock()
        return capabilities

    def close(self) -> None:
        """Close the device."""
        self._device.close()

    def use_statistics(self, statistics: dict[str, str | int | float | bool]) -> None:
        """Take from the device's statistics what they say of its clock."""
        self._synchronised = statistics.get("ptp_status") == "Slave"
        self._is_host_clock = statistics.get("clock") == "host"

    def next_frame(self, timeout_s: float) -> SensorFrame | None:
        """Return the oldest whole picture that waits, or None after `timeout_s`, at most a tenth of a second.

        Raises:
            CaptureError: from the device, or it is silent for too long.
        """
        frame = self._device.next_frame(min(timeout_s, _SLICE_S))
        if frame is None:
            self._check_alive()
            return None
        self._alive_ns = self._clock()
        if not self._has_delivered:
            self._has_delivered = True
            took_s = (self._alive_ns - self._opened_ns) * 1e-9
            self._start_limit_s = min(max(_START_MARGIN * took_s, LEAST_FIRST_FRAME_S), FIRST_FRAME_S)
        self.frames += 1
        if self._last_id is not None and frame.frame_id > self._last_id + 1:
            self.gaps += frame.frame_id - self._last_id - 1
        self._last_id = frame.frame_id
        end_ns = self._end_of_exposure(frame)
        self.exposed_ns = (end_ns - round(frame.exposure.time_s * 1e9), end_ns)
        return frame

    def _end_of_exposure(self, frame: SensorFrame) -> int:
        if frame.device_ns is None:
            self.clock_name = "arrival"
            return frame.arrival_ns
        device_end_ns = frame.device_ns + round(frame.exposure.time_s * 1e9)
        # Fed in any case: should the synchronisation be lost, it is ready.
        fitted_ns = self.clock_map.observe(device_end_ns, frame.arrival_ns)
        if self._is_host_clock:
            self.clock_name = "host"
            return min(device_end_ns, frame.arrival_ns)
        offset = shared_clock_offset(device_end_ns, frame.arrival_ns) if self._synchronised else None
        if offset is not None:
            self.clock_name = "ptp"
            return min(device_end_ns + offset, frame.arrival_ns)
        self.clock_name = "fit"
        return fitted_ns

    def _check_alive(self) -> None:
        silent_s = (self._clock() - self._alive_ns) * 1e-9
        limit_s = silence_limit_s(self._period_s, self.longest_exposure_s)
        if self._is_triggered:
            # A lost picture is asked for again first.
            limit_s = max(limit_s, _GREATEST_LIMIT_S)
        if not self._has_delivered:
            limit_s = max(limit_s, self._start_limit_s)
        if silent_s <= limit_s:
            return
        if self._has_delivered:
            raise CaptureError(
                f"camera {self._camera_id}: no picture for {silent_s:.1f} s, expected one every {self._period_s:.3g} s; "
                "the cable or its power is gone, or the camera hangs. It is opened again"
            )
        raise CaptureError(
            f"camera {self._camera_id}: opened, but no picture came within {silent_s:.1f} s; check trigger, packet size and firewall"
        )

    def set_exposure(self, exposure: Exposure) -> Exposure:
        """Expose the next pictures so."""
        rounded = self._device.set_exposure(exposure)
        self.longest_exposure_s = max(self.longest_exposure_s, rounded.time_s)
        return rounded

    def forget_exposures(self) -> None:
        """A new plan begins: the silence limit follows its exposures."""
        self.longest_exposure_s = 0.0

    def read_exposure(self) -> Exposure:
        """Ask the device how it exposes now."""
        return self._device.read_exposure()

    def trigger(self) -> None:
        """Ask for one picture."""
        self._device.trigger()

    def use_trigger(self, software: bool) -> None:
        """On request, or free running."""
        self._device.use_trigger(software)
        self._is_triggered = software

    def program_sequence(self, exposures: Sequence[Exposure]) -> tuple[Exposure, ...]:
        """Cycle through exposures."""
        rounded = self._device.program_sequence(exposures)
        self.longest_exposure_s = max(exposure.time_s for exposure in rounded)
        return rounded

    def release(self, frame: SensorFrame) -> None:
        """Give the memory of a picture back."""
        self._device.release(frame)
