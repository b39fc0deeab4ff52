"""What the ways of finding cameras say, in the words of the listing."""

from __future__ import annotations

from dataclasses import replace

import pytest

from nearfield_server.capture.aravis.gvcp import FoundCamera
from nearfield_server.capture.v4l2.discovery import FoundCamera as VideoCamera
from nearfield_server.capture.v4l2.formats import find_format
from nearfield_server.capture.v4l2.modes import FormatChoice, SizeRange
from nearfield_server.errors import CaptureError
from nearfield_server.onboarding import finder
from nearfield_server.onboarding.finder import (
    ThisMachinesFinder,
    from_answer,
    from_gige,
    from_usb,
    from_video,
)
from nearfield_server.onboarding.gige import AnsweringCamera

GIGE = FoundCamera(
    kind="gige",
    address="192.168.10.21",
    mac="00:11:22:33:44:55",
    vendor="Maker",
    model="Eye",
    serial="4711",
    user_name="door",
    interface="enp3s0",
    is_reachable=True,
)


def _answer(camera: FoundCamera, is_controlled: bool | None) -> AnsweringCamera:
    return AnsweringCamera(camera=camera, is_controlled=is_controlled, own_address="192.168.10.1")


@pytest.mark.parametrize(("is_controlled", "state"), [(False, "free"), (None, "free"), (True, "in use")])
def test_gige_cameras(is_controlled: bool | None, state: str) -> None:
    camera = from_answer(_answer(GIGE, is_controlled))
    assert (camera.kind, camera.place, camera.name, camera.serial) == (
        "gige",
        "192.168.10.21",
        "Maker Eye",
        "4711",
    )
    assert camera.state == state
    assert bool(camera.advice) == (state != "free")


def test_gige_cameras_of_another_network_are_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    stray = replace(GIGE, address="169.254.7.7", is_reachable=False, advice="give the camera another address")
    mute = replace(GIGE, address="192.168.10.22")

    def ask(address: str) -> AnsweringCamera:
        if address == mute.address:
            raise CaptureError("no answer")
        return _answer(GIGE, False)

    monkeypatch.setattr(finder, "list_gige_cameras", lambda interface: [GIGE, mute, stray])
    monkeypatch.setattr(finder, "ask_camera", ask)
    found = ThisMachinesFinder().on_interface("enp3s0")
    assert [(camera.place, camera.state, camera.advice) for camera in found] == [
        ("192.168.10.21", "free", ""),
        ("192.168.10.22", "free", "no answer"),
        ("169.254.7.7", "out of reach", "give the camera another address"),
    ]
    assert {camera.interface for camera in found} == {"enp3s0"}
    assert from_gige(GIGE).interface == "enp3s0"


def test_usb_cameras() -> None:
    usb = replace(GIGE, kind="usb3", address="", interface="/dev/bus/usb/002/017")
    assert (from_usb(usb).place, from_usb(usb).state) == ("4711", "free")
    assert from_usb(replace(usb, is_reachable=False, advice="udev rule")).state == "not allowed"


def _choice(name: str, *sizes: tuple[int, int]) -> FormatChoice:
    known = find_format(name)
    return FormatChoice(
        fourcc=known.fourcc,
        code=known.code,
        description=name,
        known=known,
        sizes=tuple(SizeRange(least=(16, 16), greatest=size) for size in sizes),
    )


def test_video_cameras_have_sizes_of_their_own_in_every_format() -> None:
    camera = from_video(
        VideoCamera(
            path="/dev/v4l/by-id/usb-web",
            node="/dev/video0",
            card="Webcam",
            formats=(
                _choice("MJPEG", (640, 480), (1920, 1080)),
                _choice("YUYV", (640, 480)),
                _choice("GREY"),
            ),
        )
    )
    assert (camera.place, camera.name, camera.state) == ("/dev/v4l/by-id/usb-web", "Webcam", "free")
    assert camera.pixel_formats == ("MJPEG", "YUYV", "GREY")
    assert [camera.size_of(name) for name in camera.pixel_formats] == [(1920, 1080), (640, 480), (0, 0)]
    assert (camera.width, camera.height) == (1920, 1080)
    locked = from_video(VideoCamera(path="/dev/video1", node="/dev/video1", problem="no permission"))
    assert (locked.state, locked.advice, locked.name) == ("not allowed", "no permission", "/dev/video1")


def test_this_machine_can_be_searched_without_any_network() -> None:
    for camera in [*ThisMachinesFinder().on_usb(), *ThisMachinesFinder().video()]:
        assert camera.kind in ("usb3", "v4l2")
    with pytest.raises(CaptureError, match="no-such-if"):
        ThisMachinesFinder().on_interface("no-such-if")
