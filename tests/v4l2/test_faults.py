"""Faults of a real driver, and how `V4l2Device` comes back from them."""

from __future__ import annotations

import os
import subprocess

import pytest
from tests.v4l2.conftest import Plug, set_control
from tests.v4l2.test_device import PATIENCE_S, device_on, opened, take

from nearfield_server.capture.v4l2.device import V4l2Device
from nearfield_server.errors import CaptureError

pytestmark = pytest.mark.vivid


def fail(device: V4l2Device) -> CaptureError:
    """Take frames until the device fails."""
    for _ in range(1000):
        try:
            frame = device.next_frame(PATIENCE_S)
        except CaptureError as error:
            return error
        if frame is not None:
            device.release(frame)
    raise AssertionError("expected a failure within 1000 frames")


@pytest.mark.parametrize("camera", [0, 1])
def test_a_pulled_plug_is_told_at_once_and_the_camera_comes_back_by_its_stable_path(
    plug: Plug, camera: int
) -> None:
    path = plug.paths[camera]
    device = device_on(path, controls={"contrast": 77})
    device.open()
    before = take(device)
    plug.pull()
    assert "the camera is gone" in str(fail(device))
    device.close()
    with pytest.raises(CaptureError, match="is it plugged in"):
        device.open()
    plug.push()
    device.open()
    after = take(device)
    assert after.frame_id == before.frame_id + 1
    assert before.data.size == after.data.size  # the picture from before can still be read
    device.close()
    assert plug.paths[camera] == path


def test_a_camera_that_disconnects_is_told_and_opened_again(plug: Plug) -> None:
    device = device_on(plug.paths[0])
    device.open()
    device.release(take(device))
    set_control(plug.paths[0], "disconnect")
    assert "the camera is gone" in str(fail(device))
    device.close()
    with opened(device):
        take(device)


def test_a_stream_that_breaks_is_told_and_opened_again(plug: Plug) -> None:
    device = device_on(plug.paths[0])
    device.open()
    set_control(plug.paths[0], "inject_fatal_streaming_error")
    assert "the camera fails" in str(fail(device))
    device.close()
    with opened(device):
        take(device)


@pytest.mark.parametrize(
    "button", ["inject_vidioc_reqbufs_error", "inject_vidioc_qbuf_error", "inject_vidioc_streamon_error"]
)
def test_a_start_that_fails_leaves_nothing_behind(plug: Plug, button: str) -> None:
    device = device_on(plug.paths[0])
    set_control(plug.paths[0], button)
    with pytest.raises(CaptureError, match="camera cam0"):
        device.open()
    with opened(device):
        take(device)


def test_a_camera_in_use_names_the_program_that_has_it(plug: Plug) -> None:
    with opened(device_on(plug.paths[0])):
        node = os.open(plug.paths[0], os.O_RDWR)
        other = subprocess.Popen(["sleep", "600"], pass_fds=[node])
        os.close(node)
        try:
            with pytest.raises(CaptureError, match=rf"in use by sleep \(process {other.pid}\)"):
                device_on(plug.paths[0]).open()
        finally:
            other.kill()
            other.wait()
    with opened(device_on(plug.paths[0])) as device:
        take(device)


def test_frames_that_are_still_referred_to_do_not_keep_the_camera_busy(plug: Plug) -> None:
    device = device_on(plug.paths[0])
    device.open()
    frame = take(device)
    picture = frame.data.copy()
    device.close()
    with opened(device):
        take(device)
    assert (frame.data == picture).all()
