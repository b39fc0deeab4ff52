"""The TCP port of the page. The supervisor holds it, so that a restarted gateway finds it again and clients only wait."""

from __future__ import annotations

import socket

from nearfield_server.errors import ServiceError

_TCP_USER_TIMEOUT = 18
_TCP_NOTSENT_LOWAT = 25


def open_listener(host: str, port: int) -> socket.socket:
    """Bind and listen on TCP `host`:`port` (0 = any free port).

    Raises:
        ServiceError: the port is in use, forbidden, or the address is not of this machine.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        raise ServiceError(
            f"cannot serve on {host} port {port}: {error.strerror}. "
            "Stop the other program, or choose another port with --port"
        ) from error
    return listener


def tune_listener(listener: socket.socket, user_timeout_ms: int = 5000) -> None:
    """Set what accepted connections inherit (Linux): a peer that takes nothing for so long is dropped, little waits in the kernel.

    Without it a client that stops reading keeps its connection for ever: a websocket ping waits behind the data that it does not take.
    """
    listener.setsockopt(socket.IPPROTO_TCP, _TCP_USER_TIMEOUT, user_timeout_ms)
    listener.setsockopt(socket.IPPROTO_TCP, _TCP_NOTSENT_LOWAT, 16384)
    # The latest packet must not sit behind a quarter megabyte of older data.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 65536)
    listener.setblocking(False)
