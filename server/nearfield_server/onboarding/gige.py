"""Asks one GigE Vision camera at its address who it is and whether it is free. Two datagrams to it, nothing else; nothing on it changes."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass

from nearfield_server.capture.aravis.gvcp import (
    CONTROL_OR_EXCLUSIVE,
    REGISTER_CONTROL,
    ControlChannel,
    FoundCamera,
)
from nearfield_server.errors import CaptureError


@dataclass(frozen=True, slots=True, kw_only=True)
class AnsweringCamera:
    """A camera that answered.

    Attributes:
        camera: what it says of itself.
        is_controlled: some program controls it; None where the camera does not tell.
        own_address: IPv4 address of this machine that it sees.
    """

    camera: FoundCamera
    is_controlled: bool | None
    own_address: str


def ask_camera(address: str) -> AnsweringCamera:
    """Ask the camera at an address.

    Raises:
        CaptureError: not the address of one machine, no way to it, or no camera there.
    """
    try:
        parsed = ipaddress.IPv4Address(address)
    except ValueError:
        raise CaptureError(f"camera {address!r}: expected an IPv4 address such as 192.168.10.21") from None
    if parsed.is_multicast or parsed.is_unspecified or parsed.is_reserved:
        raise CaptureError(
            f"camera {address}: expected the address of one camera, found one of many machines or none"
        )
    # Broadcast addresses of this machine's networks are refused by the kernel: the socket may not broadcast.
    with ControlChannel(str(parsed)) as channel:
        found = channel.describe()
        try:
            is_controlled = bool(channel.read_register(REGISTER_CONTROL) & CONTROL_OR_EXCLUSIVE)
        except CaptureError:
            return AnsweringCamera(camera=found, is_controlled=None, own_address=channel.host_address)
        return AnsweringCamera(camera=found, is_controlled=is_controlled, own_address=channel.host_address)
