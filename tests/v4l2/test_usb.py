"""`V4l2Device` on a USB camera that the kernel's own driver uvcvideo drives: exposure, gain, compressed pictures, serial number, plug."""

from __future__ import annotations

import os

import numpy as np
import pytest
from tests.v4l2.conftest import UsbPlug, set_control
from tests.v4l2.test_device import device_on, opened, take
from tests.v4l2.test_faults import fail
from tests.v4l2.usb_camera import JPEG, SIZES

from nearfield_server.capture.device import Exposure
from nearfield_server.capture.v4l2.device import V4l2Device
from nearfield_server.capture.v4l2.discovery import list_cameras, list_frame_rates
from nearfield_server.errors import CaptureError

pytestmark = pytest.mark.vivid

UNIT_S = 1e-4
"""Of the exposure control, by the USB Video Class specification."""


def usb_device(usb: UsbPlug, **keys: object) -> V4l2Device:
    return device_on(usb.path, size=SIZES[0], **keys)


def levels(device: V4l2Device, count: int) -> list[int]:
    """Levels of the next pictures: the exposure, in its units, that the camera took them with."""
    found = []
    for _ in range(count):
        frame = take(device)
        values = np.unique(frame.data[4:])
        assert values.size == 1
        found.append(int(values[0]))
        device.release(frame)
    return found


def test_it_is_found_by_serial_number_with_its_formats_and_rates(usb: UsbPlug) -> None:
    (found,) = [camera for camera in list_cameras() if camera.driver == "uvcvideo"]
    assert found.serial == usb.camera.serial
    assert found.node == os.path.realpath(usb.path)
    assert found.card.startswith("Software camera")
    assert [(choice.name, choice.sizes_in_words) for choice in found.formats] == [
        ("GREY", "160x120, 80x60"),
        ("MJPEG", "160x120"),
    ]
    assert list_frame_rates(found.path, found.formats[0], 160, 120) == pytest.approx((30.0, 5.0), rel=1e-5)


def test_opening_takes_the_exposure_from_the_automatic(usb: UsbPlug) -> None:
    camera = usb.camera
    assert camera.mode.value == 8  # aperture priority: the camera exposes by itself
    with opened(usb_device(usb, exposure_s=0.0123)) as device:
        assert (camera.mode.value, camera.exposure.value) == (1, 123)
        assert camera.gain.value == camera.gain.least
        assert device.statistics()["warnings"] == ""
        assert levels(device, 8)[-1] == 123


def test_after_the_settle_frames_every_picture_has_the_new_exposure(usb: UsbPlug) -> None:
    device = usb_device(usb, exposure_s=0.01)
    settle = device.open().settle_frames
    assert levels(device, settle + 1)[-1] == 100
    for target_s in (0.0004, 0.02, 0.0051):
        made = device.set_exposure(Exposure(time_s=target_s))
        assert made.time_s == pytest.approx(target_s)
        shown = levels(device, settle + 3)
        assert shown[settle:] == [round(target_s / UNIT_S)] * 3
    device.close()


def test_limits_are_those_of_the_camera(usb: UsbPlug) -> None:
    with pytest.raises(CaptureError, match=r"exposure_s: expected 0\.0001 to 0\.02 s, found 1 s"):
        usb_device(usb, exposure_s=1.0).open()
    with opened(usb_device(usb, gain_steps=[[0, 0.0], [100, 40.0]], gain_db=10.0)) as device:
        assert usb.camera.gain.value == 25
        made = device.set_exposure(Exposure(time_s=9.0, gain=1e6))
        assert (made.time_s, made.gain) == (pytest.approx(0.02), pytest.approx(100.0))


def test_an_exposure_changed_by_another_program_is_seen(usb: UsbPlug) -> None:
    with opened(usb_device(usb, exposure_s=0.01)) as device:
        set_control(usb.path, "exposure_time_absolute", 55)
        assert device.read_exposure().time_s == pytest.approx(0.0055)


def test_compressed_pictures_arrive_as_they_were_sent(usb: UsbPlug) -> None:
    with opened(usb_device(usb, pixel_format="MJPG")) as device:
        frame = take(device)
        assert (frame.pixel_format, frame.row_bytes, frame.data.tobytes()) == ("MJPG", 0, JPEG)


def test_a_damaged_picture_is_not_shown_but_counted(usb: UsbPlug) -> None:
    with opened(usb_device(usb)) as device:
        device.release(take(device))
        usb.camera.damage_next()
        for _ in range(100):
            levels(device, 1)
            statistics = device.statistics()
            # Older kernels drop such pictures themselves, which leaves a gap.
            if int(statistics["frames_broken"]) + int(statistics["frames_lost"]):
                return
        pytest.fail("a damaged picture was neither counted as broken nor as lost")


def test_unplugged_and_plugged_in_again_it_is_set_up_anew(usb: UsbPlug) -> None:
    device = usb_device(usb, exposure_s=0.0123, controls={"brightness": 99})
    device.open()
    device.release(take(device))
    usb.pull()
    assert "the camera is gone" in str(fail(device))
    device.close()
    with pytest.raises(CaptureError, match="is it plugged in"):
        device.open()
    usb.push()
    assert (usb.camera.mode.value, usb.camera.exposure.value) == (8, 20)  # it had no power
    with opened(device):
        assert (usb.camera.mode.value, usb.camera.exposure.value) == (1, 123)
        assert levels(device, 8)[-1] == 123
