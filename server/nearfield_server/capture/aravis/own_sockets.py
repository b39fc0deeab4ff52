"""The UDP sockets of this process, also those that libaravis has made and does not show."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path


def udp_sockets() -> Iterator[socket.socket]:
    """Every IPv4 UDP socket of this process, as a duplicate that is closed when the iteration goes on."""
    for entry in Path("/proc/self/fd").iterdir():
        try:
            descriptor = int(entry.name)
            if not stat.S_ISSOCK(os.fstat(descriptor).st_mode):
                continue
            channel = socket.socket(fileno=os.dup(descriptor))
        except OSError:
            continue  # closed meanwhile by another thread
        with contextlib.closing(channel):
            if channel.family == socket.AF_INET and channel.type == socket.SOCK_DGRAM:
                yield channel


def udp_ports(address: str) -> set[int]:
    """Ports of this process's UDP sockets that are bound to an address of this machine."""
    found = set()
    for channel in udp_sockets():
        with contextlib.suppress(OSError):
            host, port = channel.getsockname()
            if host == address and port:
                found.add(port)
    return found
