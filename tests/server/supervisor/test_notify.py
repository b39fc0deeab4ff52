"""systemd notifications over a real datagram socket."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from nearfield_server.errors import ServiceError
from nearfield_server.supervisor.notify import notify_systemd
from nearfield_server.supervisor.settings import ServiceSettings


def test_without_a_service_manager_nothing_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert not notify_systemd("READY=1")


@pytest.mark.parametrize("abstract", [False, True])
def test_the_message_arrives(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, abstract: bool) -> None:
    name = f"nearfield-test-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0" + name if abstract else name)
        manager.settimeout(10)
        monkeypatch.setenv("NOTIFY_SOCKET", "@" + name if abstract else name)
        assert notify_systemd("WATCHDOG=1")
        assert manager.recv(100) == b"WATCHDOG=1"


def test_a_manager_that_is_gone_does_no_harm(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    assert not notify_systemd("READY=1")


def test_settings_pass_through_json_and_others_are_refused() -> None:
    settings = ServiceSettings(room_path="/r", bus_port=1, launcher_pid=2, sensor={"full_well_radiance": 3.0})
    assert ServiceSettings.from_json(settings.to_json()) == settings
    for line in ("", "{}", "[]", '{"room_path": "/r", "unknown": 1}'):
        with pytest.raises(ServiceError, match="nearfield serve"):
            ServiceSettings.from_json(line)
