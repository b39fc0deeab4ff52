"""Lists the cameras of this machine's video system. Nodes are asked what they are; no stream is opened and nothing is set."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from nearfield_server.capture.v4l2.faults import explain
from nearfield_server.capture.v4l2.modes import FormatChoice, list_formats, list_rates, read_identity
from nearfield_server.capture.v4l2.video_node import KernelNode, VideoNode
from nearfield_server.errors import CaptureError


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera of this machine.

    Attributes:
        path: the name to put into a room file: one that survives replugging where there is one.
        node: what it is now ("/dev/video0").
        card: name of the camera; empty if it could not be asked.
        driver: of the kernel.
        bus: where it is plugged in.
        serial: serial number of a USB camera that has one, else empty.
        formats: pixel formats with their sizes, as the driver orders them.
        problem: why it could not be asked, in words; empty if it could.
    """

    path: str
    node: str
    card: str = ""
    driver: str = ""
    bus: str = ""
    serial: str = ""
    formats: tuple[FormatChoice, ...] = ()
    problem: str = ""


def list_cameras(
    *,
    dev: Path = Path("/dev"),
    sys: Path = Path("/sys"),
    open_node: Callable[[str], VideoNode] = KernelNode,
) -> list[FoundCamera]:
    """List every node that captures pictures, in the order of their numbers; those that cannot be asked say why.

    Args:
        dev: where device nodes are.
        sys: where the kernel describes devices.
        open_node: opens a path; replaced in tests.
    """
    nodes = [entry for entry in dev.glob("video*") if re.fullmatch(r"video\d+", entry.name)]
    found = []
    for node in sorted(nodes, key=lambda entry: int(entry.name.removeprefix("video"))):
        path = stable_path(node, dev)
        try:
            camera = inspect_camera(str(node), open_node=open_node)
        except CaptureError as error:
            found.append(FoundCamera(path=path, node=str(node), problem=str(error)))
            continue
        if camera is not None:
            serial = read_serial(node, sys)
            found.append(
                FoundCamera(path, str(node), camera.card, camera.driver, camera.bus, serial, camera.formats)
            )
    return found


def inspect_camera(path: str, *, open_node: Callable[[str], VideoNode] = KernelNode) -> FoundCamera | None:
    """Ask one node what it offers; None if it captures no pictures.

    Raises:
        CaptureError: it cannot be opened or asked; says why.
    """
    node: VideoNode | None = None
    try:
        node = open_node(path)
        identity = read_identity(node)
        if identity.buffer_type is None:
            return None
        return FoundCamera(
            path=path,
            node=str(Path(path).resolve()),
            card=identity.card,
            driver=identity.driver,
            bus=identity.bus,
            formats=list_formats(node, identity.buffer_type),
        )
    except OSError as error:
        raise explain(error, "", path, "ask the device what it is") from error
    finally:
        if node is not None:
            node.close()


def list_frame_rates(
    path: str,
    choice: FormatChoice,
    width: int,
    height: int,
    *,
    open_node: Callable[[str], VideoNode] = KernelNode,
) -> tuple[float, ...]:
    """List frame rates of a format and size of a camera, frames per second, descending; empty where the driver does not tell.

    Raises:
        CaptureError: it cannot be opened or asked; says why.
    """
    node: VideoNode | None = None
    try:
        node = open_node(path)
        return list_rates(node, choice.fourcc, width, height)
    except OSError as error:
        raise explain(error, "", path, "ask the device for its frame rates") from error
    finally:
        if node is not None:
            node.close()


def stable_path(node: Path, dev: Path = Path("/dev")) -> str:
    """Return the name of a node that survives replugging: by identity, else by the place where it is plugged in, else the node itself."""
    for folder in ("by-id", "by-path"):
        for link in sorted((dev / "v4l" / folder).glob("*")):
            if link.resolve() == node.resolve():
                return str(link)
    return str(node)


def read_serial(node: Path, sys: Path = Path("/sys")) -> str:
    """Return the serial number of the USB device that a node (or a link to it) belongs to; empty if it has none.

    Args:
        node: for example /dev/video0.
        sys: where the kernel describes devices.
    """
    entry = sys / "class" / "video4linux" / node.resolve().name
    try:
        raw = ((entry / "device").resolve(strict=True).parent / "serial").read_text(
            encoding="utf-8", errors="replace"
        )
    except OSError:
        return ""
    return "".join(character for character in raw.strip() if character.isprintable())[:64]
