"""Commands of the service's own user: heard, answered, and refused from everyone else."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from typing import Any

import pytest

from nearfield_server.errors import ServiceError
from nearfield_server.supervisor import control_socket
from nearfield_server.supervisor.control_socket import (
    ControlSocket,
    RunningService,
    running_services,
    socket_name,
)


def _handle(request: dict[str, Any]) -> dict[str, Any]:
    if request.get("command") == "fail":
        raise ServiceError("not today")
    return {"echo": request}


def _raw(data: bytes) -> bytes:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as channel:
        channel.settimeout(30)
        channel.connect("\0" + socket_name(os.getpid()))
        channel.sendall(data)
        channel.shutdown(socket.SHUT_WR)
        found = b""
        while part := channel.recv(65536):
            found += part
        return found


def test_a_running_service_is_found_asked_and_gone() -> None:
    own = RunningService(os.getpid())
    with ControlSocket(_handle):
        assert own in running_services()
        assert own.ask({"command": "x", "n": 1}) == {"echo": {"command": "x", "n": 1}}
        with pytest.raises(ServiceError, match="not today"):
            own.ask({"command": "fail"})
        with pytest.raises(ServiceError, match="cannot listen"):
            ControlSocket(_handle)
    assert own not in running_services()
    with pytest.raises(ServiceError, match="has probably ended"):
        own.ask({})


@pytest.mark.parametrize("data", [b"", b"\n", b"[]\n", b"{", b"[" * 10_000 + b"\n", b"\xff\xfe\n", b"null\n"])
def test_what_is_no_command_is_answered_with_an_error_and_the_next_one_is_heard(data: bytes) -> None:
    with ControlSocket(_handle):
        assert "error" in json.loads(_raw(data))
        assert RunningService(os.getpid()).ask({"a": 1}) == {"echo": {"a": 1}}


def test_another_user_is_not_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[Any] = []
    with ControlSocket(lambda request: called.append(request) or {}):
        monkeypatch.setattr(control_socket, "_is_own", lambda connection: False)
        # The service hangs up without reading.
        with contextlib.suppress(ConnectionResetError, BrokenPipeError):
            assert _raw(b'{"command":"record"}\n') == b""
    assert called == []


def test_the_kernel_says_who_is_at_the_other_end() -> None:
    left, right = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    with left, right:
        assert control_socket._is_own(left)
