from __future__ import annotations

import errno
from pathlib import Path

from tests.server.capture.v4l2.scripted_kernel import ScriptedCamera, ScriptedNode

from nearfield_server.capture.v4l2 import kernel_api as api
from nearfield_server.capture.v4l2.discovery import list_cameras, list_frame_rates
from nearfield_server.capture.v4l2.modes import SizeRange


def test_cameras_are_listed_by_stable_path_with_what_they_offer(tmp_path: Path) -> None:
    dev, sys = tmp_path / "dev", tmp_path / "sys"
    camera = ScriptedCamera(formats={"RG12": [(64, 48), (32, 24)], "H264": [(64, 48)]}, rates=(30, 15))
    camera.stepwise["GREY"] = (16, 64, 8, 16, 48, 8)
    camera.formats["GREY"] = [(64, 48)]
    cameras = {
        "video10": camera,
        "video2": ScriptedCamera(capabilities=api.Capability.META_CAPTURE | api.Capability.STREAMING),
        "video3": ScriptedCamera(),
    }
    cameras["video3"].open_error = errno.EACCES
    (dev / "v4l" / "by-id").mkdir(parents=True)
    for name in cameras:
        (dev / name).touch()
    (dev / "video-not-a-node").touch()
    stable = dev / "v4l" / "by-id" / "usb-Scripted_1234-video-index0"
    stable.symlink_to("../../video10")
    usb = sys / "devices" / "usb1" / "1-1"
    (usb / "1-1:1.0").mkdir(parents=True)
    (usb / "serial").write_text("1234\n", encoding="utf-8")
    (sys / "class" / "video4linux" / "video10").mkdir(parents=True)
    (sys / "class" / "video4linux" / "video10" / "device").symlink_to(usb / "1-1:1.0")

    def open_node(path: str) -> ScriptedNode:
        return cameras[Path(path).name].open(path)

    forbidden, found = list_cameras(dev=dev, sys=sys, open_node=open_node)
    assert "usermod -aG" in forbidden.problem
    assert forbidden.node == str(dev / "video3")
    assert (found.path, found.node) == (str(stable), str(dev / "video10"))
    assert (found.card, found.driver, found.serial, found.problem) == (
        "Scripted camera",
        "scripted",
        "1234",
        "",
    )
    assert [(choice.name, choice.known is not None) for choice in found.formats] == [
        ("SRGGB12", True),
        ("H264", False),
        ("GREY", True),
    ]
    assert [str(size) for size in found.formats[0].sizes] == ["64x48", "32x24"]
    assert [str(size) for size in found.formats[2].sizes] == ["16x16 to 64x48 in steps of 8x8"]
    assert list_frame_rates(str(stable), found.formats[0], 64, 48, open_node=lambda _: camera.open("")) == (
        30.0,
        15.0,
    )
    assert all(camera.open_nodes == 0 and camera.owner is None for camera in cameras.values())
    assert camera.written == []


def test_a_machine_without_cameras_has_none(tmp_path: Path) -> None:
    assert list_cameras(dev=tmp_path, sys=tmp_path) == []


def test_ranges_of_sizes_hold_what_lies_on_their_steps() -> None:
    sizes = SizeRange((16, 16), (64, 48), (8, 16))
    assert sizes.holds(24, 32)
    assert not sizes.holds(25, 32)
    assert not sizes.holds(72, 32)
    assert SizeRange((64, 48), (64, 48)).holds(64, 48)
    assert not SizeRange((64, 48), (64, 48)).holds(64, 47)
