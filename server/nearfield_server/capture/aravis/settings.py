"""Everything that the room file says of a camera, set on the device in an order that works, and checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from nearfield_server.capture.aravis.exposure_control import ExposureControl, linear_gain
from nearfield_server.capture.aravis.features import Features
from nearfield_server.capture.device import Exposure
from nearfield_server.errors import CaptureError
from nearfield_server.imaging.pixel_formats import pixel_format
from nearfield_server.scene.device_schema import AravisSourceTable

_MOST_EXTRA_BYTES: Final = 4 << 20  # of a payload beyond its picture: chunks, alignment
_RATE_SWITCHES: Final = ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled")
_RATES: Final = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
_LARGEST_PAYLOAD_BYTES: Final = 1 << 30


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureLayout:
    """What every picture must look like.

    Attributes:
        pixel_format: its name. format_code: its number.
        width: pixels. height: pixels.
        payload_bytes: of a whole picture with what the device adds.
    """

    pixel_format: str
    format_code: int
    width: int
    height: int
    payload_bytes: int

    @property
    def bits_per_pixel(self) -> int:
        """Bits of a pixel in memory, as its number says (GenICam Pixel Format Values 1.1, 2: bits 16 to 23)."""
        return self.format_code >> 16 & 0xFF

    def image_bytes(self, padding: int) -> int:
        """Bytes of a picture with so many bytes of padding after each row."""
        if padding:
            return self.row_bytes(padding) * self.height
        return -(-self.width * self.height * self.bits_per_pixel // 8)

    def row_bytes(self, padding: int) -> int:
        """Bytes from one row to the next; 0 for packed formats without padding, whose rows need not begin at a byte."""
        if self.bits_per_pixel % 8 and not padding:
            return 0
        return -(-self.width * self.bits_per_pixel // 8) + padding


def apply_settings(
    features: Features,
    exposure: ExposureControl,
    table: AravisSourceTable,
    width: int,
    height: int,
    frame_rate: float,
) -> list[str]:
    """Set everything except what belongs to the stream; returns warnings in words.

    Automatics are switched off first, then come the `features` of the room file in their order, then its other keys, which win.

    Args:
        features: of the device.
        exposure: of the device.
        table: of the room file.
        width: pixels, as calibrated.
        height: pixels, as calibrated.
        frame_rate: pictures per second.

    Raises:
        CaptureError: the camera refuses a setting; says which, and what it would take.
    """
    exposure.switch_automatics_off()
    for name, value in table.features.items():
        features.set(name, value)
    _set_binning(features, table.binning)
    features.set("PixelFormat", table.pixel_format)
    features.set_if_possible("AcquisitionMode", "Continuous")
    _set_region(features, table, width, height)
    exposure.read_ranges()
    if table.exposure_s is not None or table.gain_db != 0.0:
        wanted = Exposure(time_s=table.exposure_s or exposure.read().time_s, gain=linear_gain(table.gain_db))
        made = exposure.set(wanted)
        if abs(made.amount / wanted.amount - 1.0) > 0.05:
            raise CaptureError(
                f"expected an exposure of {wanted.time_s:g} s and gain {wanted.gain:.3f}, "
                f"the camera made {made.time_s:g} s and {made.gain:.3f} of it; "
                f"it takes {exposure.range_s[0]:g} to {exposure.range_s[1]:g} s "
                f"and gains {exposure.gain_range[0]:.3f} to {exposure.gain_range[1]:.3f}"
            )
    warnings = []
    if table.trigger == "free":
        warnings.append(set_frame_rate(features, frame_rate))
    elif table.trigger == "software":
        lift_frame_rate(features)
    warnings += [
        f"{name} is on: exposures change behind the labels of the pictures; set it Off"
        for name in exposure.running_automatics()
    ]
    return [warning for warning in warnings if warning]


def read_layout(features: Features, table: AravisSourceTable, width: int, height: int) -> PictureLayout:
    """Read back what pictures will look like.

    Raises:
        CaptureError: not as set, or the payload has a size that cannot be.
    """
    found = (features.text("PixelFormat"), int(features.number("Width")), int(features.number("Height")))
    if found != (table.pixel_format, width, height):
        raise CaptureError(
            f"expected {table.pixel_format} of {width} x {height} pixels, the camera has {found[0]} of {found[1]} x {found[2]}"
        )
    layout = PictureLayout(
        pixel_format=table.pixel_format,
        format_code=int(features.number("PixelFormat")),
        width=width,
        height=height,
        payload_bytes=int(features.number("PayloadSize")),
    )
    known_bits = pixel_format(table.pixel_format).pixel_bits
    if layout.bits_per_pixel != known_bits:
        raise CaptureError(
            f"expected {layout.pixel_format} to have {known_bits} bits per pixel, "
            f"the camera's number for it ({layout.format_code:#010x}) says {layout.bits_per_pixel}"
        )
    least = layout.image_bytes(0)
    if (
        not least <= layout.payload_bytes <= min(2 * least + _MOST_EXTRA_BYTES, _LARGEST_PAYLOAD_BYTES)
        or least == 0
    ):
        raise CaptureError(
            f"expected a payload of {least} bytes and a little more for {layout.pixel_format} of {width} x {height} pixels, "
            f"the camera names {layout.payload_bytes}"
        )
    return layout


def set_frame_rate(features: Features, frame_rate: float) -> str:
    """Set pictures per second, as near as the camera can; returns a warning in words, "" if it can.

    Raises:
        CaptureError: the camera refuses.
    """
    for switch in _RATE_SWITCHES:
        features.set_if_possible(switch, True)
    features.set_if_possible("AcquisitionFrameRateAuto", "Off")
    name = features.first(*_RATES)
    if name is None or not features.is_writable(name):
        return "the camera's frame rate cannot be set: it sends as fast as it likes"
    made = features.set_clamped(name, frame_rate)
    if abs(made / frame_rate - 1.0) > 0.02:
        least, greatest = features.range(name)
        return (
            f"frame rate {frame_rate:g} Hz asked, the camera made {made:.3g} Hz of it; "
            f"with these settings it takes {least:.3g} to {greatest:.3g} Hz"
        )
    return ""


def lift_frame_rate(features: Features) -> None:
    """Let the camera answer triggers as fast as it can: most let the frame rate limit triggered pictures too."""
    if not any([features.set_if_possible(switch, False) for switch in _RATE_SWITCHES]):
        name = features.first(*_RATES)
        if name is not None and features.is_writable(name):
            features.set_clamped(name, features.range(name)[1])


def set_trigger(features: Features, trigger: str) -> None:
    """Let pictures be taken "free" running, on "software" request, or at a "hardware" signal (its source is left to `features`).

    Raises:
        CaptureError: the camera has no such trigger.
    """
    if trigger == "free":
        for selector in ("AcquisitionStart", "FrameBurstStart", "FrameStart"):
            if features.set_if_possible("TriggerSelector", selector):
                features.set_if_possible("TriggerMode", "Off")
        features.set_if_possible("TriggerMode", "Off")
        return
    features.set_if_possible("TriggerSelector", "FrameStart")
    if trigger == "software":
        features.set("TriggerSource", "Software")
    features.set("TriggerMode", "On")


def has_software_trigger(features: Features) -> bool:
    """Whether pictures can be asked for one by one."""
    return (
        features.kind("TriggerSoftware") is not None
        and features.kind("TriggerSource") == "enumeration"
        and "Software" in features.entries("TriggerSource")
    )


def _set_region(features: Features, table: AravisSourceTable, width: int, height: int) -> None:
    """Set what part of the sensor is sent; it must be the `width` x `height` pixels that the camera is calibrated for."""
    for name in ("OffsetX", "OffsetY"):  # away with an old offset: it limits the size
        features.set_if_possible(name, 0)
    if table.region is None:
        whole = tuple(int(features.range(name)[1]) for name in ("Width", "Height"))
        if whole != (width, height):
            raise CaptureError(
                f"the camera's whole picture has {whole[0]} x {whole[1]} pixels, its calibration {width} x {height}; "
                f"calibrate it anew, or say which part of the picture is calibrated: region = [x, y, {width}, {height}]"
            )
        x, y = 0, 0
    else:
        x, y, *size = table.region
        if tuple(size) != (width, height):
            raise CaptureError(
                f"expected a region of {width} x {height} pixels (the calibrated size), found {size[0]} x {size[1]}"
            )
    for name, value in (("Width", width), ("Height", height), ("OffsetX", x), ("OffsetY", y)):
        if value or name in ("Width", "Height") or features.has(name):
            features.set(name, value)


def _set_binning(features: Features, binning: int) -> None:
    names = [name for name in ("BinningHorizontal", "BinningVertical") if features.has(name)]
    if binning > 1 and not names:
        raise CaptureError(f"the camera has no binning; expected binning = 1, found {binning}")
    for name in names:
        if features.number(name) != binning:
            features.set(name, binning)
