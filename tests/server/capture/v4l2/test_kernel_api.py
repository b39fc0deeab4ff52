"""Layouts against the numbers of the kernel's interface: every request number carries the size of its structure."""

from __future__ import annotations

import ctypes
import sys

import pytest

from nearfield_server.capture.v4l2 import kernel_api as api

# As the kernel decodes them on 64-bit machines (strace prints the same).
REQUESTS_64 = {
    "QUERYCAP": 0x80685600,
    "ENUM_FMT": 0xC0405602,
    "G_FMT": 0xC0D05604,
    "S_FMT": 0xC0D05605,
    "REQBUFS": 0xC0145608,
    "QUERYBUF": 0xC0585609,
    "QBUF": 0xC058560F,
    "DQBUF": 0xC0585611,
    "STREAMON": 0x40045612,
    "STREAMOFF": 0x40045613,
    "G_PARM": 0xC0CC5615,
    "S_PARM": 0xC0CC5616,
    "QUERYMENU": 0xC02C5625,
    "G_EXT_CTRLS": 0xC0205647,
    "S_EXT_CTRLS": 0xC0205648,
    "ENUM_FRAMESIZES": 0xC02C564A,
    "ENUM_FRAMEINTERVALS": 0xC034564B,
    "QUERY_EXT_CTRL": 0xC0E85667,
}


@pytest.mark.skipif(sys.maxsize < 2**32, reason="numbers of 64-bit machines")
def test_requests_are_those_of_the_kernel() -> None:
    assert {request.name: request.value for request in api.Request} == REQUESTS_64


def test_the_multi_planar_layout_fills_192_bytes_and_a_plane_64() -> None:
    assert ctypes.sizeof(api.PixFormatMplane) == 192
    assert ctypes.sizeof(api.Plane) == (64 if ctypes.sizeof(ctypes.c_long) == 8 else 60)
    assert ctypes.sizeof(api.ExtControl) == 20


def test_text_of_a_device_is_made_harmless() -> None:
    assert api.text(b"USB camera\0garbage") == "USB camera"
    assert api.text(b"\x1b[31mred\nline\0") == "?[31mred?line"
    assert api.text(b"\xff\xfe") == "\ufffd\ufffd"
