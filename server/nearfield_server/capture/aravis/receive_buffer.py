"""The kernel's buffer for packets that libaravis has not yet read: too small, and pictures arrive with holes."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
from pathlib import Path
from typing import Final

_SO_RCVBUFFORCE: Final = 33
_PAYLOADS: Final = 3
_LEAST_BYTES: Final = 1 << 20
_MOST_BYTES: Final = 256 << 20


def wanted_bytes(payload_bytes: int) -> int:
    """Receive buffer for a payload, bytes: three pictures, so that one may wait while two arrive; at least 1 MiB, at most 256 MiB."""
    return min(max(_PAYLOADS * payload_bytes, _LEAST_BYTES), _MOST_BYTES)


def buffer_warning(wanted: int, granted: int) -> str:
    """Words for the user where the kernel grants less than is wanted; "" where it does not."""
    if granted >= wanted:
        return ""
    return (
        f"the kernel grants a receive buffer of {granted} bytes where {wanted} are needed: packets will be lost; "
        f"allow more: sysctl -w net.core.rmem_max={wanted}"
    )


def can_open_packet_sockets() -> bool:
    """Whether libaravis receives by a packet socket (with CAP_NET_RAW), which has a ring of its own and needs no receive buffer."""
    try:
        socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0).close()
    except OSError:
        return False
    return True


def enlarge_receive_buffer(port: int, wanted: int) -> int:
    """Enlarge the receive buffer of this process's UDP socket on a port; returns the bytes granted, 0 if there is no such socket.

    With CAP_NET_ADMIN the limit `net.core.rmem_max` does not bind. The kernel doubles the size for its book-keeping; not counted here.
    """
    channel = _own_udp_socket(port)
    if channel is None:
        return 0
    with channel:
        channel.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted)
        with contextlib.suppress(OSError):
            channel.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, wanted)
        return channel.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


def _own_udp_socket(port: int) -> socket.socket | None:
    for entry in Path("/proc/self/fd").iterdir():
        try:
            descriptor = int(entry.name)
            if not stat.S_ISSOCK(os.fstat(descriptor).st_mode):
                continue
            channel = socket.socket(fileno=os.dup(descriptor))
        except OSError:
            continue  # closed meanwhile by another thread
        with contextlib.suppress(OSError):
            if (
                channel.family == socket.AF_INET
                and channel.type == socket.SOCK_DGRAM
                and channel.getsockname()[1] == port
            ):
                return channel
        channel.close()
    return None
