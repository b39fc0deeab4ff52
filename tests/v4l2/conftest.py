"""Virtual cameras: those of the kernel driver vivid, and a software camera at the kernel's virtual USB port.

Tests marked `vivid` are skipped where there are none: `make test-v4l2` brings them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from tests.v4l2.usb_camera import PORT, UsbCamera

from nearfield_server.capture.v4l2.controls import ControlSet
from nearfield_server.capture.v4l2.discovery import list_cameras
from nearfield_server.capture.v4l2.video_node import KernelNode

_CLASS = Path("/sys/class/video4linux")
_DRIVER = Path("/sys/bus/platform/drivers/vivid")


def vivid_nodes() -> list[str]:
    """Device nodes of the virtual cameras, in the order of the cameras."""
    names = {}
    for entry in _CLASS.glob("video*"):
        name = (entry / "name").read_text(encoding="utf-8").strip()
        if name.startswith("vivid-") and name.endswith("-vid-cap"):
            names[name] = f"/dev/{entry.name}"
    return [names[name] for name in sorted(names)]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave out what needs a device of the driver, and say how to get one."""
    if not vivid_nodes():
        reason = "this machine has no device of the kernel driver vivid: make test-v4l2 runs these tests, in a virtual machine if need be"
        for item in items:
            if item.get_closest_marker("vivid"):
                item.add_marker(pytest.mark.skip(reason=reason))


class Plug:
    """The plug of the virtual cameras, and links to them that survive replugging, as udev makes them in /dev/v4l/by-id.

    Attributes:
        paths: of the links, one per camera.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.paths: list[str] = []
        self.link()

    def link(self) -> None:
        """Let the links point to where the cameras are now."""
        for old in self._folder.iterdir():
            old.unlink()
        self.paths = []
        for index, node in enumerate(vivid_nodes()):
            link = self._folder / f"usb-vivid_{index}-video-index0"
            link.symlink_to(node)
            self.paths.append(str(link))

    def pull(self) -> None:
        """Take the cameras from the machine."""
        (_DRIVER / "unbind").write_text("vivid.0", encoding="ascii")
        for link in self._folder.iterdir():
            link.unlink()

    def push(self) -> None:
        """Bring them back."""
        (_DRIVER / "bind").write_text("vivid.0", encoding="ascii")
        self.link()


@pytest.fixture
def plug() -> Iterator[Plug]:
    # Under /dev, where room files expect device nodes, and writable.
    with TemporaryDirectory(dir="/dev/shm", prefix="nearfield-vivid-") as folder:
        yield Plug(Path(folder))
    for node in vivid_nodes():
        set_control(node, "percentage_of_dropped_buffers", 0)


class UsbPlug:
    """A software camera at the virtual USB port, and its link as udev makes it.

    Attributes:
        camera: the camera. path: of the link.
    """

    def __init__(self, folder: Path) -> None:
        self.camera = UsbCamera()
        self._link = folder / f"usb-Nearfield_Software_camera_{self.camera.serial}-video-index0"
        self.path = str(self._link)

    def push(self) -> None:
        """Plug the camera in and wait for the kernel to know it."""
        wait_for(PORT.exists)
        self.camera.plug()
        wait_for(self._nodes)
        self._link.symlink_to(self._nodes()[0])

    def pull(self) -> None:
        """Pull the plug and wait for the kernel to notice."""
        self.camera.unplug()
        self._link.unlink(missing_ok=True)
        wait_for(lambda: not self._nodes())

    def _nodes(self) -> list[str]:
        return [camera.node for camera in list_cameras() if camera.serial == self.camera.serial]


@pytest.fixture
def usb() -> Iterator[UsbPlug]:
    with TemporaryDirectory(dir="/dev/shm", prefix="nearfield-usb-") as folder:
        plug = UsbPlug(Path(folder))
        plug.push()
        yield plug
        plug.pull()


def wait_for(condition: Callable[[], object]) -> None:
    """Wait until something is the case, for a minute at most."""
    end_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end_s, "waited for a minute"
        time.sleep(0.05)


def set_control(path: str, name: str, value: int = 1) -> None:
    """Set a control, or press a button, from outside of the stream."""
    node = KernelNode(path)
    try:
        controls = ControlSet(node)
        controls.set(controls.named(name), value)
    finally:
        node.close()
