"""The kernel's buffer for packets that libaravis has not yet read: too small, and pictures arrive with holes."""

from __future__ import annotations

import contextlib
import socket
from typing import Final

from nearfield_server.capture.aravis.own_sockets import udp_sockets

_SO_RCVBUFFORCE: Final = 33
_PAYLOADS: Final = 3
_LEAST_BYTES: Final = 1 << 20
_MOST_BYTES: Final = 256 << 20


def wanted_bytes(payload_bytes: int) -> int:
    """Receive buffer for a payload, bytes: three pictures, so that one may wait while two arrive; at least 1 MiB, at most 256 MiB."""
    return min(max(_PAYLOADS * payload_bytes, _LEAST_BYTES), _MOST_BYTES)


def buffer_warning(payload_bytes: int, granted: int) -> str:
    """Words for the user where the kernel grants less than two pictures, with which pictures are lost; "" where it does not."""
    needed = min(2 * payload_bytes, _MOST_BYTES)
    if granted >= needed:
        return ""
    return (
        f"the kernel grants a receive buffer of {granted} bytes where {needed} are needed: packets will be lost; "
        f"allow more: sysctl -w net.core.rmem_max={wanted_bytes(payload_bytes)}"
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
    for channel in udp_sockets():
        if channel.getsockname()[1] == port:
            channel.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted)
            with contextlib.suppress(OSError):
                channel.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, wanted)
            return channel.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
    return 0
