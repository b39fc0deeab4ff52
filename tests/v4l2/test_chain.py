"""The whole way on real drivers: camera, device, development, brackets, source; unplugged and plugged in again."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from tests.v4l2.conftest import Plug, UsbPlug, wait_for
from tests.v4l2.usb_camera import SIZES

from nearfield_server.capture.darkroom import Darkroom
from nearfield_server.capture.device_source import DeviceCamera, DeviceSource, pictures_per_second
from nearfield_server.capture.source import RawFrame
from nearfield_server.capture.v4l2.device import V4l2Device
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import V4l2SourceTable

pytestmark = pytest.mark.vivid

RATE = 5.0
WIDTH, HEIGHT = 320, 180
GREEN, NO_TEXT = 8, 2
CODES_PER_SECOND = 1e4
"""The software camera sends one code per unit of exposure, 100 us."""


def source_of(path: str, size: tuple[int, int], **keys: Any) -> DeviceSource:
    table = V4l2SourceTable(kind="v4l2", path=path, **keys)
    width, height = size
    device = V4l2Device("cam0", table, width, height, pictures_per_second(table, RATE))
    camera = DeviceCamera(camera_id="cam0", table=table, height=height, width=width, frame_rate=RATE)
    return DeviceSource(camera, device, Darkroom("cam0", table, width, height))


@contextmanager
def opened(source: DeviceSource) -> Iterator[DeviceSource]:
    try:
        source.open()
        yield source
    finally:
        source.close()


def next_picture(source: DeviceSource) -> RawFrame:
    found: list[RawFrame] = []

    def look() -> bool:
        source.wait_for_frame(threading.Event(), 1.0 / RATE)
        frame = source.next_frame(0)
        if frame is not None:
            found.append(frame)
        return bool(found)

    wait_for(look)
    return found[0]


def test_a_raw_picture_becomes_linear_colour(plug: Plug) -> None:
    source = source_of(
        plug.paths[1],
        (WIDTH, HEIGHT),
        pixel_format="SRGGB12",
        exposure_s=0.01,
        radiance_per_code=2.0,
        controls={"test_pattern": GREEN, "osd_text_mode": NO_TEXT},
    )
    with opened(source):
        frame = next_picture(source)
    pixels = np.asarray(frame.pixels, np.float64)
    # Full codes mean 2 W/(sr m^2) of a second at least: 200 in 10 ms, and no red or blue next to them.
    np.testing.assert_allclose(pixels[..., 1], 200.0, rtol=1e-3)
    np.testing.assert_array_equal(pixels[..., [0, 2]], 0.0)
    assert (pixels[..., 3] > 0.5).all()
    assert (pixels[..., 3] < 1.0).all()  # saturated: a lower bound
    assert frame.metadata["pixel_format"] == "BayerRG12"


def radiance_is_right(frame: RawFrame) -> None:
    """The software camera shows a wall of 10^4 codes per second: that share of 255 per code, whatever the exposure."""
    pixels = np.asarray(frame.pixels, np.float64)[1:]
    np.testing.assert_allclose(pixels[..., :3], CODES_PER_SECOND / 255.0, rtol=2e-3)  # half floats
    np.testing.assert_array_equal(pixels[..., 3], 1.0)


def test_a_usb_camera_measures_radiance_and_heals_when_it_is_plugged_in_again(usb: UsbPlug) -> None:
    source = source_of(usb.path, SIZES[0], pixel_format="GREY", exposure_s=0.0123)
    source.open()
    for _ in range(6):  # the first ones may still be exposed as the automatic left it
        frame = next_picture(source)
    radiance_is_right(frame)
    assert frame.metadata["exposures_s"] == [pytest.approx(0.0123)]
    before_ns = frame.timestamp_ns
    usb.pull()
    with pytest.raises(CaptureError, match="the camera is gone"):
        next_picture(source)
    source.close()
    with pytest.raises(CaptureError, match="is it plugged in"):
        source.open()
    usb.push()
    source.open()
    for _ in range(6):
        frame = next_picture(source)
    radiance_is_right(frame)
    assert frame.timestamp_ns > before_ns
    described = source.describe()
    source.close()
    assert described["reconnects"] == 1
    assert described["clock_source"] == "host"
    assert described["serial"] == usb.camera.serial


def test_a_bracket_of_a_usb_camera_is_merged_with_the_right_exposures(usb: UsbPlug) -> None:
    exposures = [0.02, 0.008, 0.0032]
    source = source_of(
        usb.path,
        SIZES[0],
        pixel_format="GREY",
        hdr={"mode": "bracket", "exposures_s": exposures, "settle_frames": 3},
    )
    with opened(source):
        for _ in range(3):
            frame = next_picture(source)
            radiance_is_right(frame)
            assert sorted(frame.metadata["exposures_s"], reverse=True) == pytest.approx(exposures)
        assert source.describe()["brackets_inconsistent"] == 0
