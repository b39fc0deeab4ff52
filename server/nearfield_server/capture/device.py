"""What a camera device looks like to `DeviceSource`: sensor codes out, exposures in. GigE Vision, USB3 Vision and V4L2 implement it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """How a frame is exposed.

    Attributes:
        time_s: exposure time, seconds.
        gain: linear factor on the signal (1 = 0 dB).
    """

    time_s: float
    gain: float = 1.0

    @property
    def amount(self) -> float:
        """Codes per radiance are proportional to this: seconds times gain."""
        return self.time_s * self.gain


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceCapabilities:
    """What an opened device can do.

    Attributes:
        exposure_range_s: shortest and longest exposure time, seconds; equal where it cannot be set.
        gain_range: least and largest linear gain; (1, 1) where it cannot be set.
        software_trigger: frames can be asked for one by one.
        sequencer: the device cycles through a programmed list of exposures by itself.
        labels_exposure: every frame says which exposure it had (chunk data).
        settle_frames: frames after a change of the exposure that may still have the old one.
        device_clock: frames carry the device's own time.
    """

    exposure_range_s: tuple[float, float]
    gain_range: tuple[float, float] = (1.0, 1.0)
    software_trigger: bool = False
    sequencer: bool = False
    labels_exposure: bool = False
    settle_frames: int = 2
    device_clock: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorFrame:
    """A picture as the device sent it: nothing interpreted, nothing copied.

    Attributes:
        data: (bytes,) uint8, the payload; valid until the frame is given back with `Device.release`.
        pixel_format: name of the EMVA Pixel Format Naming Convention ("BayerRG12p", "Mono8"); for compressed pictures "MJPG".
        width: pixels. height: pixels.
        row_bytes: from one row to the next; 0 for packed formats without padding and for compressed ones.
        frame_id: counts up by one per exposed picture, unwrapped; a gap means that pictures were lost.
        device_ns: the device's own time of the start of the exposure; None where it has no clock.
        arrival_ns: CLOCK_MONOTONIC when the whole picture had arrived.
        exposure: of this frame: as labelled by the device, else as commanded.
        is_labelled: the device itself labelled the exposure of this frame.
    """

    data: NDArray[np.uint8]
    pixel_format: str
    width: int
    height: int
    row_bytes: int = 0
    frame_id: int
    device_ns: int | None
    arrival_ns: int
    exposure: Exposure
    is_labelled: bool = False


class Device(Protocol):
    """A camera device. All methods are called from one thread; failures are `CaptureError` in words.

    After a CaptureError the owner calls `close()`, and later `open()` again, which applies every setting anew: devices forget them.
    """

    def open(self) -> DeviceCapabilities:
        """Connect, apply every setting of the room file, start the stream.

        Raises:
            CaptureError: no such device, in use by someone else, or it refuses a setting; says which, and what it would take.
        """

    def close(self) -> None:
        """Stop and give everything back; may be called twice and on a dead device, and returns within a second."""

    def set_exposure(self, exposure: Exposure) -> Exposure:
        """Expose the next frames so; returns what the device made of it (devices round)."""

    def read_exposure(self) -> Exposure:
        """Ask the device how it exposes now: someone else, or an automatic of its own, may have changed it.

        Devices that cannot tell return what they were set to last.
        """

    def trigger(self) -> None:
        """Ask for one frame; only with `software_trigger` switched on by `use_trigger`."""

    def use_trigger(self, software: bool) -> None:
        """Frames on request (true) or free running at the frame rate of the room (false)."""

    def program_sequence(self, exposures: Sequence[Exposure]) -> tuple[Exposure, ...]:
        """Let the device cycle through exposures by itself; only with `sequencer`. Returns them as rounded by the device."""

    def next_frame(self, timeout_s: float) -> SensorFrame | None:
        """The oldest whole frame that waits; None after `timeout_s` seconds without one. Broken frames are counted, not returned.

        Raises:
            CaptureError: the device is gone (unplugged, control lost).
        """

    def release(self, frame: SensorFrame) -> None:
        """Give the memory of a frame back to the device."""

    def statistics(self) -> dict[str, str | int | float | bool]:
        """Numbers for the status page; never raises and never talks to the device for longer than a frame takes.

        `frames_lost`, `frames_broken`, `temperature_c` where offered, and whatever helps to find faults. Keys with a meaning for others:
        `model`, `serial`, `address` or `path`; `warnings` (lines of words); `ptp_status` ("Slave": the device's clock is synchronised);
        `clock` = "host" where `device_ns` is CLOCK_MONOTONIC of this machine already.
        """
