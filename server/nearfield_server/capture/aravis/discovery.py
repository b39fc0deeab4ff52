"""Finding cameras: on the one network interface that the user names, and on USB. No other interface sees a packet.

libaravis asks on every interface of the machine at once, so the question is asked here: one datagram of 8 bytes, broadcast through a
socket that is bound to the interface. USB3 Vision cameras are read from sysfs.
"""

from __future__ import annotations

import fcntl
import ipaddress
import os
import socket
import struct
import time
from pathlib import Path
from typing import Final

from nearfield_server.capture.aravis.gvcp import PORT, FoundCamera, decode_discovery, discovery_command
from nearfield_server.capture.aravis.library import printable
from nearfield_server.errors import CaptureError

_SIOCGIFADDR: Final = 0x8915
_SIOCGIFNETMASK: Final = 0x891B
_MOST_CAMERAS: Final = 256
_USB3_VISION_CLASS: Final = ("ef", "05")  # USB3 Vision 1.0, 3.2: miscellaneous device, subclass USB3 Vision


def list_cameras(interface: str, wait_s: float = 0.8) -> list[FoundCamera]:
    """Ask for GigE Vision cameras on one network interface.

    Args:
        interface: its name ("enp3s0"); nothing is sent on any other.
        wait_s: how long answers are waited for; the question is asked twice in that time.

    Returns:
        The cameras by address; one that answered twice is listed once.

    Raises:
        CaptureError: no such interface, it has no IPv4 address, or sockets cannot be bound to it.
    """
    address, subnet = _interface_network(interface)
    found: dict[tuple[str, str], FoundCamera] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as channel:
        try:
            channel.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, interface.encode() + b"\0")
            channel.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            channel.bind((str(address), 0))
        except OSError as error:
            raise CaptureError(
                f"cannot look for cameras on interface {interface}: {error.strerror}"
            ) from error
        until_s = time.monotonic() + wait_s
        for share in (0.5, 1.0):
            _ask(channel, interface, subnet)
            _collect(channel, interface, subnet, until_s - wait_s * (1 - share), found)
    return sorted(found.values(), key=lambda camera: ipaddress.IPv4Address(camera.address))


def list_usb_cameras(sysfs: Path = Path("/sys/bus/usb/devices")) -> list[FoundCamera]:
    """List the USB3 Vision cameras of this machine, from what the kernel knows; nothing is opened."""
    devices = {
        interface.resolve().parent
        for interface in sysfs.glob("*:*")
        if (_attribute(interface, "bInterfaceClass"), _attribute(interface, "bInterfaceSubClass"))
        == _USB3_VISION_CLASS
    }
    return [_usb_camera(device) for device in sorted(devices)]


def find_by_serial(serial: str, interface: str | None) -> FoundCamera:
    """Find the one camera with a serial number: on USB, or on the network interface if one is named.

    Raises:
        CaptureError: none or several have it, or it cannot be reached as things are; says what was found.
    """
    cameras = list_usb_cameras() if interface is None else list_cameras(interface)
    where = "on USB" if interface is None else f"on interface {interface}"
    matching = [camera for camera in cameras if camera.serial == serial]
    if len(matching) != 1:
        others = ", ".join(f"{camera.vendor} {camera.model} {camera.serial}" for camera in cameras) or "none"
        count = "no camera" if not matching else f"{len(matching)} cameras"
        hint = (
            " (a GigE camera is looked for only on the `interface` of the room file)"
            if interface is None
            else ""
        )
        raise CaptureError(
            f"expected one camera with serial {serial} {where}{hint}, found {count}; there: {others}"
        )
    if not matching[0].is_reachable:
        raise CaptureError(f"camera {serial} {where} cannot be opened: {matching[0].advice}")
    return matching[0]


def _interface_network(interface: str) -> tuple[ipaddress.IPv4Address, ipaddress.IPv4Network]:
    try:
        socket.if_nametoindex(interface)
    except OSError as error:
        names = ", ".join(name for _, name in socket.if_nameindex())
        raise CaptureError(
            f"expected a network interface, found none called {interface}; there are: {names}"
        ) from error
    request = struct.pack("256s", interface.encode()[:15])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as channel:
        try:
            address, mask = (
                fcntl.ioctl(channel, code, request)[20:24] for code in (_SIOCGIFADDR, _SIOCGIFNETMASK)
            )
        except OSError as error:
            raise CaptureError(
                f"interface {interface} has no IPv4 address; GigE cameras need one: ip addr add ADDRESS/24 dev {interface}"
            ) from error
    host = ipaddress.IPv4Address(address)
    return host, ipaddress.IPv4Network((host, str(ipaddress.IPv4Address(mask))), strict=False)


def _ask(channel: socket.socket, interface: str, subnet: ipaddress.IPv4Network) -> None:
    sent, reason = False, ""
    for target in ("255.255.255.255", str(subnet.broadcast_address)):
        try:
            channel.sendto(discovery_command(), (target, PORT))
            sent = True
        except OSError as error:
            reason = error.strerror or str(error)
    if not sent:
        raise CaptureError(f"cannot ask for cameras on interface {interface}: {reason}")


def _collect(
    channel: socket.socket,
    interface: str,
    subnet: ipaddress.IPv4Network,
    until_s: float,
    found: dict[tuple[str, str], FoundCamera],
) -> None:
    while (left_s := until_s - time.monotonic()) > 0 and len(found) < _MOST_CAMERAS:
        channel.settimeout(left_s)
        try:
            packet, (_, port) = channel.recvfrom(2048)
        except TimeoutError:
            return
        camera = decode_discovery(packet, interface, subnet)
        if camera is not None and port == PORT:
            found[camera.mac, camera.address] = camera


def _attribute(folder: Path, name: str) -> str:
    try:
        return printable((folder / name).read_bytes()[:256]).strip("? \n")
    except OSError:
        return ""


def _usb_camera(device: Path) -> FoundCamera:
    bus, number = _attribute(device, "busnum"), _attribute(device, "devnum")
    node = Path(f"/dev/bus/usb/{bus.zfill(3)}/{number.zfill(3)}")
    is_reachable = os.access(node, os.R_OK | os.W_OK)
    rule = f'SUBSYSTEM=="usb", ATTRS{{idVendor}}=="{_attribute(device, "idVendor")}", MODE="0666"'
    advice = "" if is_reachable else f"no permission for {node}; add a udev rule: {rule}"
    speed = _attribute(device, "speed")
    if is_reachable and speed.isdigit() and int(speed) < 5000:
        advice = f"it runs at {speed} Mbit/s only: use a USB 3 port and cable"
    return FoundCamera(
        kind="usb3",
        address="",
        mac="",
        vendor=_attribute(device, "manufacturer"),
        model=_attribute(device, "product"),
        serial=_attribute(device, "serial"),
        user_name="",
        interface=str(node),
        is_reachable=is_reachable,
        advice=advice,
    )
