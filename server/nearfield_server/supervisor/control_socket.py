"""Commands for a running service from the command line of the user who started it.

An abstract Unix socket named after user and process: it leaves nothing behind, it is reachable from this machine alone, and the kernel
says who is at the other end. Only the service's own user and root are heard: a command may name folders to write to, which no
web page and no other user must be able to.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import structlog

from nearfield_server.errors import NearfieldError, ServiceError

MAX_MESSAGE: Final = 1 << 20
_TIMEOUT_S: Final = 10.0
_CREDENTIALS: Final = struct.Struct("3i")

_log = structlog.get_logger("nearfield.supervisor")

Handler = Callable[[dict[str, Any]], dict[str, Any]]


def socket_name(pid: int) -> str:
    """Name of the socket of a service of this user, without the leading zero byte of abstract names."""
    return f"nearfield/{os.geteuid()}/{pid}"


class ControlSocket:
    """The service's end: one JSON line in, one out, per connection.

    Args:
        handler: called in a thread of its own, one call at a time; a NearfieldError becomes `{"error": words}`.
    """

    def __init__(self, handler: Handler) -> None:
        self._handler = handler
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            self._socket.bind("\0" + socket_name(os.getpid()))
            self._socket.listen(8)
        except OSError as error:
            self._socket.close()
            raise ServiceError(f"cannot listen for commands: {error.strerror}") from error
        self._thread = threading.Thread(target=self._serve, name="commands", daemon=True)

    def __enter__(self) -> ControlSocket:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # Closing alone would not wake a thread that waits in accept().
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._thread.join(timeout=2.0)

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            with connection:
                try:
                    connection.settimeout(_TIMEOUT_S)
                    self._answer(connection)
                except OSError as error:
                    _log.warning("command not answered", reason=str(error))

    def _answer(self, connection: socket.socket) -> None:
        if not _is_own(connection):
            return
        try:
            request = json.loads(_receive_line(connection))
            if not isinstance(request, dict):
                raise ServiceError("expected a JSON object")
            reply = self._handler(request)
        except NearfieldError as error:
            reply = {"error": str(error)}
        except (ValueError, RecursionError) as error:
            reply = {"error": f"not a command ({error})"}
        connection.sendall(json.dumps(reply).encode() + b"\n")


@dataclass(frozen=True, slots=True)
class RunningService:
    """A service of this user that runs on this machine."""

    pid: int

    def ask(self, request: dict[str, Any], timeout_s: float = _TIMEOUT_S) -> dict[str, Any]:
        """Send a command and return the answer.

        Raises:
            ServiceError: the service is gone or refuses; in its words.
        """
        channel = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            with channel:
                channel.settimeout(timeout_s)
                channel.connect("\0" + socket_name(self.pid))
                if not _is_own(channel):
                    raise ServiceError(f"service {self.pid} belongs to another user")
                channel.sendall(json.dumps(request).encode() + b"\n")
                reply = json.loads(_receive_line(channel))
        except (OSError, ValueError) as error:
            raise ServiceError(
                f"service {self.pid} does not answer ({error}); it has probably ended"
            ) from error
        if not isinstance(reply, dict):
            raise ServiceError(f"service {self.pid} answers {type(reply).__name__}, expected an object")
        if "error" in reply:
            raise ServiceError(str(reply["error"]))
        return reply


def running_services() -> list[RunningService]:
    """All services of this user on this machine."""
    prefix = f"@{socket_name(0)[:-1]}"
    found = set()
    for line in Path("/proc/net/unix").read_text(encoding="utf-8", errors="replace").splitlines()[1:]:
        name = line.rpartition(" ")[2]
        number = name.removeprefix(prefix)
        if name.startswith(prefix) and number.isdigit():
            found.add(int(number))
    return [RunningService(pid) for pid in sorted(found)]


def _is_own(connection: socket.socket) -> bool:
    """Whether the other end is of this user, or root."""
    raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    _, user, _ = _CREDENTIALS.unpack(raw)
    return user in (os.geteuid(), 0)


def _receive_line(connection: socket.socket) -> bytes:
    data = b""
    while not data.endswith(b"\n"):
        part = connection.recv(65536)
        if not part:
            break
        data += part
        if len(data) > MAX_MESSAGE:
            raise ServiceError(f"a message of more than {MAX_MESSAGE} bytes")
    return data
