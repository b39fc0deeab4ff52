"""Asks a node for a pixel format, size and frame rate, and insists on what was asked: drivers silently take the nearest they have."""

from __future__ import annotations

import errno
from dataclasses import dataclass
from fractions import Fraction

from nearfield_server.capture.v4l2 import kernel_api as api
from nearfield_server.capture.v4l2.formats import V4l2Format, code_of
from nearfield_server.capture.v4l2.modes import describe_choices, list_formats
from nearfield_server.capture.v4l2.video_node import VideoNode
from nearfield_server.errors import CaptureError


@dataclass(frozen=True, slots=True)
class Picture:
    """How pictures lie in memory.

    Attributes:
        format: pixel format.
        pixel_format: its name for `SensorFrame`, the range of luma included.
        width: pixels. height: pixels.
        row_bytes: from one row to the next, padding included; 0 for compressed pictures.
        least_bytes: a shorter picture is broken.
        is_rec709: luma and chroma are mixed as in HD television; `imaging` reads them as BT.601, which shifts colours a little.
    """

    format: V4l2Format
    pixel_format: str
    width: int
    height: int
    row_bytes: int
    least_bytes: int
    is_rec709: bool = False


_FULL_RANGE_NAMES = {"YUYV": "YUV422_8", "UYVY": "YUV422_8_UYVY"}


def set_picture(
    node: VideoNode, buffer_type: api.BufferType, wanted: V4l2Format, width: int, height: int
) -> Picture:
    """Set format and size.

    Raises:
        CaptureError: the device does not offer them; lists what it offers.
        OSError: the device is gone or in use.
    """
    is_planar = buffer_type == api.BufferType.CAPTURE_MPLANE
    request = api.Format(type=buffer_type)
    pix = request.pix_mp if is_planar else request.pix
    pix.width, pix.height, pix.pixelformat, pix.field = width, height, wanted.fourcc, api.Field.NONE
    if is_planar:
        pix.num_planes = 1
    try:
        node.call(api.Request.S_FMT, request)
    except OSError as error:
        if error.errno == errno.EINVAL:
            raise _not_offered(node, buffer_type, wanted, width, height, "nothing like it") from error
        raise
    found = (pix.pixelformat, pix.width, pix.height)
    if found != (wanted.fourcc, width, height):
        offered = f"{code_of(found[0]).strip()} {found[1]}x{found[2]}"
        raise _not_offered(node, buffer_type, wanted, width, height, f"{offered} instead")
    if pix.field not in (api.Field.NONE, api.Field.ANY):
        raise CaptureError(
            f"the device delivers interlaced pictures (field order {pix.field}); expected a progressive mode"
        )
    if is_planar and pix.num_planes != 1:
        raise CaptureError(
            f"pixel_format {wanted.usual_name}: the device spreads a picture over {pix.num_planes} pieces of memory; "
            "expected one"
        )
    row_bytes = 0 if wanted.is_compressed else int((pix.plane_fmt[0] if is_planar else pix).bytesperline)
    name, is_rec709 = wanted.pixel_format, False
    if name in _FULL_RANGE_NAMES:
        is_jpeg = pix.colorspace == api.COLORSPACE_JPEG
        if pix.quantization == api.QUANTIZATION_FULL_RANGE or (
            is_jpeg and pix.quantization == api.QUANTIZATION_DEFAULT
        ):
            name = _FULL_RANGE_NAMES[name]
        is_rec709 = pix.ycbcr_enc == api.YCBCR_ENC_709 or (
            pix.ycbcr_enc == api.YCBCR_ENC_DEFAULT and pix.colorspace == api.COLORSPACE_REC709
        )
    least_bytes = 4  # of a JPEG file
    if not wanted.is_compressed:
        row_bytes, least_bytes = _layout(wanted, width, height, row_bytes)
    return Picture(wanted, name, width, height, row_bytes, least_bytes, is_rec709)


def _layout(wanted: V4l2Format, width: int, height: int, row_bytes: int) -> tuple[int, int]:
    """Bytes from row to row, and of a picture without padding after its last row."""
    needed = wanted.row_bytes(width)
    row_bytes = row_bytes or needed
    if row_bytes < needed:
        raise CaptureError(
            f"pixel_format {wanted.usual_name}: a row of {width} pixels takes {needed} bytes, but the driver says {row_bytes}"
        )
    return row_bytes, row_bytes * (height - 1) + needed


def _not_offered(
    node: VideoNode, buffer_type: api.BufferType, wanted: V4l2Format, width: int, height: int, found: str
) -> CaptureError:
    offered = list_formats(node, buffer_type)
    usable = describe_choices([choice for choice in offered if choice.known])
    others = ", ".join(choice.code.strip() for choice in offered if not choice.known)
    return CaptureError(
        f"expected {wanted.usual_name} at {width}x{height} (pixel_format, width and height of the room file), "
        f"the device takes {found}. It offers: {usable or 'no format that can be read'}"
        + (f"; not readable: {others}" if others else "")
    )


def set_frame_rate(node: VideoNode, buffer_type: api.BufferType, frame_rate: float) -> float | None:
    """Ask for a frame rate; returns what the device made of it, frames per second, None where it cannot be set or told.

    Raises:
        OSError: the device is gone or in use.
    """
    answer = api.StreamParm(type=buffer_type)
    try:
        node.call(api.Request.G_PARM, answer)
        if answer.capture.capability & api.CAPABILITY_TIME_PER_FRAME:
            period = 1 / Fraction(frame_rate).limit_denominator(1001)
            answer.capture.timeperframe = api.Fraction(period.numerator, period.denominator)
            node.call(api.Request.S_PARM, answer)
    except OSError as error:
        if error.errno in (errno.ENOTTY, errno.EINVAL):
            return None
        raise
    period_now = answer.capture.timeperframe
    if not period_now.numerator or not period_now.denominator:
        return None
    return float(period_now.denominator / period_now.numerator)
