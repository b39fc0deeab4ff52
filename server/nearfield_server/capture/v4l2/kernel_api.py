"""The part of the kernel's video interface (V4L2, linux/videodev2.h) that cameras need: structures, requests and constants.

Layouts follow the V4L2 specification for the machine's own word size; each request number carries the size of its structure, so a
layout that differs from the kernel's is refused with ENOTTY instead of being misread.
"""

from __future__ import annotations

import ctypes
from ctypes import c_char, c_int32, c_int64, c_long, c_uint8, c_uint16, c_uint32, c_uint64, c_ulong
from enum import IntEnum, IntFlag
from typing import Any

MAX_PLANES = 8


class Capability(IntFlag):
    """What a device node can do (`QueryCap.device_caps`)."""

    VIDEO_CAPTURE = 0x1
    VIDEO_CAPTURE_MPLANE = 0x1000
    VIDEO_M2M_MPLANE = 0x4000
    VIDEO_M2M = 0x8000
    META_CAPTURE = 0x0080_0000
    STREAMING = 0x0400_0000
    IO_MC = 0x2000_0000
    DEVICE_CAPS = 0x8000_0000


class BufferType(IntEnum):
    """Which queue of a node is meant: pictures in one piece of memory, or with a list of planes."""

    CAPTURE = 1
    CAPTURE_MPLANE = 9


class Field(IntEnum):
    """How lines are interleaved; cameras are progressive (NONE)."""

    ANY = 0
    NONE = 1


MEMORY_MMAP = 1
COLORSPACE_REC709 = 3
COLORSPACE_JPEG = 7
YCBCR_ENC_DEFAULT = 0
YCBCR_ENC_709 = 2
QUANTIZATION_DEFAULT = 0
QUANTIZATION_FULL_RANGE = 1


class BufferFlag(IntFlag):
    """State of a buffer."""

    QUEUED = 0x2
    DONE = 0x4
    ERROR = 0x40
    TIMESTAMP_MASK = 0xE000
    TIMESTAMP_MONOTONIC = 0x2000
    TIMESTAMP_SOURCE_MASK = 0x7_0000
    TIMESTAMP_START_OF_EXPOSURE = 0x1_0000
    LAST = 0x10_0000


class ControlType(IntEnum):
    """Kind of a control's value."""

    INTEGER = 1
    BOOLEAN = 2
    MENU = 3
    BUTTON = 4
    INTEGER64 = 5
    CTRL_CLASS = 6
    STRING = 7
    BITMASK = 8
    INTEGER_MENU = 9


class ControlFlag(IntFlag):
    """State of a control."""

    DISABLED = 0x1
    GRABBED = 0x2
    READ_ONLY = 0x4
    INACTIVE = 0x10
    WRITE_ONLY = 0x40
    VOLATILE = 0x80
    HAS_PAYLOAD = 0x100
    EXECUTE_ON_WRITE = 0x200
    NEXT_CTRL = 0x8000_0000


class ControlId(IntEnum):
    """Standard controls that this project sets by itself."""

    BRIGHTNESS = 0x0098_0900
    CONTRAST = 0x0098_0901
    SATURATION = 0x0098_0902
    HUE = 0x0098_0903
    AUTO_WHITE_BALANCE = 0x0098_090C
    RED_BALANCE = 0x0098_090E
    BLUE_BALANCE = 0x0098_090F
    GAMMA = 0x0098_0910
    EXPOSURE = 0x0098_0911
    AUTOGAIN = 0x0098_0912
    GAIN = 0x0098_0913
    HFLIP = 0x0098_0914
    VFLIP = 0x0098_0915
    HUE_AUTO = 0x0098_0919
    WHITE_BALANCE_TEMPERATURE = 0x0098_091A
    SHARPNESS = 0x0098_091B
    BACKLIGHT_COMPENSATION = 0x0098_091C
    COLORFX = 0x0098_091F
    AUTOBRIGHTNESS = 0x0098_0920
    EXPOSURE_AUTO = 0x009A_0901
    EXPOSURE_ABSOLUTE = 0x009A_0902
    EXPOSURE_AUTO_PRIORITY = 0x009A_0903
    AUTO_N_PRESET_WHITE_BALANCE = 0x009A_0914
    WIDE_DYNAMIC_RANGE = 0x009A_0915
    ISO_SENSITIVITY_AUTO = 0x009A_0918
    VBLANK = 0x009E_0901
    HBLANK = 0x009E_0902
    ANALOGUE_GAIN = 0x009E_0903
    PIXEL_RATE = 0x009F_0902


class ExposureAuto(IntEnum):
    """Items of the menu EXPOSURE_AUTO."""

    AUTO = 0
    MANUAL = 1
    SHUTTER_PRIORITY = 2
    APERTURE_PRIORITY = 3


CAPABILITY_TIME_PER_FRAME = 0x1000  # of StreamParm: the frame rate can be set


class SizeType(IntEnum):
    """How sizes or frame intervals are listed."""

    DISCRETE = 1
    CONTINUOUS = 2
    STEPWISE = 3


class QueryCap(ctypes.Structure):
    """struct v4l2_capability."""

    _fields_ = [
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    ]


class FmtDesc(ctypes.Structure):
    """struct v4l2_fmtdesc."""

    _fields_ = [
        ("index", c_uint32),
        ("type", c_uint32),
        ("flags", c_uint32),
        ("description", c_char * 32),
        ("pixelformat", c_uint32),
        ("mbus_code", c_uint32),
        ("reserved", c_uint32 * 3),
    ]


class Fraction(ctypes.Structure):
    """struct v4l2_fract."""

    _fields_ = [("numerator", c_uint32), ("denominator", c_uint32)]


class FrameSizeStepwise(ctypes.Structure):
    """struct v4l2_frmsize_stepwise."""

    _fields_ = [
        ("min_width", c_uint32),
        ("max_width", c_uint32),
        ("step_width", c_uint32),
        ("min_height", c_uint32),
        ("max_height", c_uint32),
        ("step_height", c_uint32),
    ]


class FrameSizeDiscrete(ctypes.Structure):
    """struct v4l2_frmsize_discrete."""

    _fields_ = [("width", c_uint32), ("height", c_uint32)]


class _FrameSizeUnion(ctypes.Union):
    _fields_ = [("discrete", FrameSizeDiscrete), ("stepwise", FrameSizeStepwise)]


class FrameSize(ctypes.Structure):
    """struct v4l2_frmsizeenum."""

    _anonymous_ = ("u",)
    _fields_ = [
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("type", c_uint32),
        ("u", _FrameSizeUnion),
        ("reserved", c_uint32 * 2),
    ]


class FrameIntervalStepwise(ctypes.Structure):
    """struct v4l2_frmival_stepwise."""

    _fields_ = [("min", Fraction), ("max", Fraction), ("step", Fraction)]


class _FrameIntervalUnion(ctypes.Union):
    _fields_ = [("discrete", Fraction), ("stepwise", FrameIntervalStepwise)]


class FrameInterval(ctypes.Structure):
    """struct v4l2_frmivalenum."""

    _anonymous_ = ("u",)
    _fields_ = [
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("type", c_uint32),
        ("u", _FrameIntervalUnion),
        ("reserved", c_uint32 * 2),
    ]


class PixFormat(ctypes.Structure):
    """struct v4l2_pix_format."""

    _fields_ = [
        ("width", c_uint32),
        ("height", c_uint32),
        ("pixelformat", c_uint32),
        ("field", c_uint32),
        ("bytesperline", c_uint32),
        ("sizeimage", c_uint32),
        ("colorspace", c_uint32),
        ("priv", c_uint32),
        ("flags", c_uint32),
        ("ycbcr_enc", c_uint32),
        ("quantization", c_uint32),
        ("xfer_func", c_uint32),
    ]


class PlanePixFormat(ctypes.Structure):
    """struct v4l2_plane_pix_format."""

    _pack_ = 1
    _fields_ = [("sizeimage", c_uint32), ("bytesperline", c_uint32), ("reserved", c_uint16 * 6)]


class PixFormatMplane(ctypes.Structure):
    """struct v4l2_pix_format_mplane."""

    _pack_ = 1
    _fields_ = [
        ("width", c_uint32),
        ("height", c_uint32),
        ("pixelformat", c_uint32),
        ("field", c_uint32),
        ("colorspace", c_uint32),
        ("plane_fmt", PlanePixFormat * MAX_PLANES),
        ("num_planes", c_uint8),
        ("flags", c_uint8),
        ("ycbcr_enc", c_uint8),
        ("quantization", c_uint8),
        ("xfer_func", c_uint8),
        ("reserved", c_uint8 * 7),
    ]


class _FormatUnion(ctypes.Union):
    # The kernel's union also holds a structure with pointers, hence its alignment.
    _fields_ = [
        ("pix", PixFormat),
        ("pix_mp", PixFormatMplane),
        ("raw_data", c_uint8 * 200),
        ("alignment", ctypes.c_void_p),
    ]


class Format(ctypes.Structure):
    """struct v4l2_format."""

    _anonymous_ = ("fmt",)
    _fields_ = [("type", c_uint32), ("fmt", _FormatUnion)]


class RequestBuffers(ctypes.Structure):
    """struct v4l2_requestbuffers."""

    _fields_ = [
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint8),
        ("reserved", c_uint8 * 3),
    ]


class _PlaneUnion(ctypes.Union):
    _fields_ = [("mem_offset", c_uint32), ("userptr", c_ulong), ("fd", c_int32)]


class Plane(ctypes.Structure):
    """struct v4l2_plane."""

    _anonymous_ = ("m",)
    _fields_ = [
        ("bytesused", c_uint32),
        ("length", c_uint32),
        ("m", _PlaneUnion),
        ("data_offset", c_uint32),
        ("reserved", c_uint32 * 11),
    ]


class _TimeCode(ctypes.Structure):
    _fields_ = [
        ("type", c_uint32),
        ("flags", c_uint32),
        ("frames", c_uint8),
        ("seconds", c_uint8),
        ("minutes", c_uint8),
        ("hours", c_uint8),
        ("userbits", c_uint8 * 4),
    ]


class _BufferUnion(ctypes.Union):
    _fields_ = [
        ("offset", c_uint32),
        ("userptr", c_ulong),
        ("planes", ctypes.POINTER(Plane)),
        ("fd", c_int32),
    ]


class Buffer(ctypes.Structure):
    """struct v4l2_buffer."""

    _anonymous_ = ("m",)
    _fields_ = [
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("timestamp_s", c_long),
        ("timestamp_us", c_long),
        ("timecode", _TimeCode),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("m", _BufferUnion),
        ("length", c_uint32),
        ("reserved2", c_uint32),
        ("request_fd", c_int32),
    ]


class _CaptureParm(ctypes.Structure):
    _fields_ = [
        ("capability", c_uint32),
        ("capturemode", c_uint32),
        ("timeperframe", Fraction),
        ("extendedmode", c_uint32),
        ("readbuffers", c_uint32),
        ("reserved", c_uint32 * 4),
    ]


class _StreamParmUnion(ctypes.Union):
    _fields_ = [("capture", _CaptureParm), ("raw_data", c_uint8 * 200)]


class StreamParm(ctypes.Structure):
    """struct v4l2_streamparm."""

    _anonymous_ = ("parm",)
    _fields_ = [("type", c_uint32), ("parm", _StreamParmUnion)]


class QueryExtCtrl(ctypes.Structure):
    """struct v4l2_query_ext_ctrl."""

    _fields_ = [
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_char * 32),
        ("minimum", c_int64),
        ("maximum", c_int64),
        ("step", c_uint64),
        ("default_value", c_int64),
        ("flags", c_uint32),
        ("elem_size", c_uint32),
        ("elems", c_uint32),
        ("nr_of_dims", c_uint32),
        ("dims", c_uint32 * 4),
        ("reserved", c_uint32 * 32),
    ]


class _MenuUnion(ctypes.Union):
    _pack_ = 1
    _fields_ = [("name", c_char * 32), ("value", c_int64)]


class QueryMenu(ctypes.Structure):
    """struct v4l2_querymenu."""

    _pack_ = 1
    _anonymous_ = ("u",)
    _fields_ = [("id", c_uint32), ("index", c_uint32), ("u", _MenuUnion), ("reserved", c_uint32)]


class _ExtControlUnion(ctypes.Union):
    _pack_ = 1
    _fields_ = [("value", c_int32), ("value64", c_int64), ("pointer", ctypes.c_void_p)]


class ExtControl(ctypes.Structure):
    """struct v4l2_ext_control."""

    _pack_ = 1
    _anonymous_ = ("u",)
    _fields_ = [
        ("id", c_uint32),
        ("size", c_uint32),
        ("reserved2", c_uint32),
        ("u", _ExtControlUnion),
    ]


class ExtControls(ctypes.Structure):
    """struct v4l2_ext_controls."""

    _fields_ = [
        ("which", c_uint32),
        ("count", c_uint32),
        ("error_idx", c_uint32),
        ("request_fd", c_int32),
        ("reserved", c_uint32),
        ("controls", ctypes.POINTER(ExtControl)),
    ]


_WRITE, _READ = 1, 2


def _request(direction: int, number: int, argument: type[Any]) -> int:
    """Request number as the kernel's _IOC macro makes it."""
    return direction << 30 | ctypes.sizeof(argument) << 16 | ord("V") << 8 | number


class Request(IntEnum):
    """Request numbers (VIDIOC_...)."""

    QUERYCAP = _request(_READ, 0, QueryCap)
    ENUM_FMT = _request(_READ | _WRITE, 2, FmtDesc)
    G_FMT = _request(_READ | _WRITE, 4, Format)
    S_FMT = _request(_READ | _WRITE, 5, Format)
    REQBUFS = _request(_READ | _WRITE, 8, RequestBuffers)
    QUERYBUF = _request(_READ | _WRITE, 9, Buffer)
    QBUF = _request(_READ | _WRITE, 15, Buffer)
    DQBUF = _request(_READ | _WRITE, 17, Buffer)
    STREAMON = _request(_WRITE, 18, c_int32)
    STREAMOFF = _request(_WRITE, 19, c_int32)
    G_PARM = _request(_READ | _WRITE, 21, StreamParm)
    S_PARM = _request(_READ | _WRITE, 22, StreamParm)
    QUERYMENU = _request(_READ | _WRITE, 37, QueryMenu)
    G_EXT_CTRLS = _request(_READ | _WRITE, 71, ExtControls)
    S_EXT_CTRLS = _request(_READ | _WRITE, 72, ExtControls)
    ENUM_FRAMESIZES = _request(_READ | _WRITE, 74, FrameSize)
    ENUM_FRAMEINTERVALS = _request(_READ | _WRITE, 75, FrameInterval)
    QUERY_EXT_CTRL = _request(_READ | _WRITE, 103, QueryExtCtrl)


def text(raw: bytes) -> str:
    """Text of a fixed-length field: devices write it, so anything that is no printable character becomes '?'."""
    decoded = raw.split(b"\0", 1)[0].decode("utf-8", "replace").strip()
    return "".join(character if character.isprintable() else "?" for character in decoded)
