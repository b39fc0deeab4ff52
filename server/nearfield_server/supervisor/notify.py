"""Telling systemd how the service does (`Type=notify`, `WatchdogSec=`)."""

from __future__ import annotations

import contextlib
import os
import socket


def notify_systemd(message: str) -> bool:
    """Send one message such as `READY=1` to the service manager; false (and nothing sent) when there is none."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return False
    if address.startswith("@"):
        address = "\0" + address[1:]
    # A service manager that does not listen must not stop the light.
    with (
        contextlib.suppress(OSError),
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel,
    ):
        channel.sendto(message.encode(), address)
        return True
    return False
