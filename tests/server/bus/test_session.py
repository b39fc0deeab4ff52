"""The bus between real sessions: who hears what, and that nothing leaves loopback."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nearfield_server.bus.session import Bus, loopback_config
from nearfield_server.errors import BusError


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@pytest.fixture
def port() -> int:
    return _free_port()


@pytest.fixture
def hub(port: int) -> Iterator[Bus]:
    with Bus("lab", listen_port=port) as bus:
        yield bus


class _Inbox:
    def __init__(self) -> None:
        self._messages: list[tuple[str, bytes]] = []
        self._changed = threading.Condition()

    def __call__(self, key: str, payload: bytes) -> None:
        with self._changed:
            self._messages.append((key, payload))
            self._changed.notify_all()

    def wait(self, message: tuple[str, bytes]) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: message in self._messages, timeout=120)


def _put_until_heard(sender: Bus, inbox: _Inbox, key: str, payload: bytes) -> None:
    """A subscription travels to the sender in its own time; the first messages may come before it."""
    for _ in range(1000):
        sender.put(key, payload)
        with inbox._changed:
            if inbox._changed.wait_for(lambda: (key, payload) in inbox._messages, timeout=0.1):
                return
    raise AssertionError(f"{key} never arrived")


def test_children_of_one_hub_hear_each_other(hub: Bus, port: int) -> None:
    with Bus("lab", connect_port=port) as left, Bus("lab", connect_port=port) as right:
        inbox = _Inbox()
        right.subscribe("light/*", inbox)
        _put_until_heard(left, inbox, "light/packet", b"\x00\xff")


def test_messages_pass_after_the_hub_is_gone_and_after_a_new_one_came(port: int) -> None:
    hub = Bus("lab", listen_port=port)
    with Bus("lab", connect_port=port) as left, Bus("lab", connect_port=port) as right:
        inbox = _Inbox()
        right.subscribe("x", inbox)
        _put_until_heard(left, inbox, "x", b"1")
        hub.close()
        _put_until_heard(left, inbox, "x", b"2")
        with Bus("lab", listen_port=port) as hub:
            new_inbox = _Inbox()
            hub.subscribe("x", new_inbox)
            _put_until_heard(left, new_inbox, "x", b"3")
            assert inbox.wait(("x", b"3"))


def test_rooms_do_not_hear_each_other(hub: Bus, port: int) -> None:
    with Bus("other", connect_port=port) as stranger, Bus("lab", connect_port=port) as friend:
        inbox = _Inbox()
        hub.subscribe("x", inbox)
        _put_until_heard(friend, inbox, "x", b"friend")
        stranger.put("x", b"stranger")
        _put_until_heard(friend, inbox, "x", b"last")
        assert ("x", b"stranger") not in inbox._messages


def test_questions_get_the_present_answer(hub: Bus, port: int) -> None:
    present = [b"first"]

    def ask_until_answered(asker: Bus) -> bytes:
        for _ in range(1000):
            answer = asker.ask("control/state", timeout_s=1.0)
            if answer is not None:
                return answer
            time.sleep(0.02)  # without a link there is nobody to wait for: `ask` returns at once
        raise AssertionError("no answer")

    with Bus("lab", connect_port=port) as asker:
        assert asker.ask("control/state", timeout_s=0.2) is None
        hub.answer("control/state", lambda: present[0])
        assert ask_until_answered(asker) == b"first"
        present[0] = b"second"
        assert ask_until_answered(asker) == b"second"


def test_a_failing_handler_ends_only_its_own_call(hub: Bus, port: int) -> None:
    with Bus("lab", connect_port=port) as sender:
        inbox = _Inbox()

        def handler(key: str, payload: bytes) -> None:
            if payload == b"bad":
                raise RuntimeError("broken handler")
            inbox(key, payload)

        hub.subscribe("x", handler)
        _put_until_heard(sender, inbox, "x", b"good")
        sender.put("x", b"bad")
        _put_until_heard(sender, inbox, "x", b"after")


def test_a_killed_process_is_seen_to_be_gone(hub: Bus, port: int) -> None:
    states: dict[str, bool] = {}
    changed = threading.Condition()

    def note(process: str, is_alive: bool) -> None:
        with changed:
            states[process] = is_alive
            changed.notify_all()

    hub.watch_alive(note)
    code = f"from nearfield_server.bus.session import Bus; b = Bus('lab', connect_port={port}); b.announce('cam0'); input()"
    child = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE)
    try:
        with changed:
            assert changed.wait_for(lambda: states.get("cam0") is True, timeout=120)
        child.kill()
        with changed:
            assert changed.wait_for(lambda: states.get("cam0") is False, timeout=120)
    finally:
        child.kill()
        child.wait()
        assert child.stdin is not None
        child.stdin.close()


def test_a_port_in_use_is_an_error_in_words(hub: Bus, port: int) -> None:
    with pytest.raises(BusError, match=f"port {port} of 127.0.0.1"):
        Bus("lab", listen_port=port)


def test_a_closed_bus_says_so(port: int) -> None:
    bus = Bus("lab", listen_port=port)
    bus.close()
    bus.close()
    with pytest.raises(BusError, match="cannot send"):
        bus.put("x", b"")


def _own_sockets(table: str) -> list[tuple[str, str]]:
    """(local address in hex, state) of this process's sockets in a table of /proc/net."""
    inodes = set()
    for fd in os.listdir("/proc/self/fd"):
        try:
            target = os.readlink(f"/proc/self/fd/{fd}")
        except FileNotFoundError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    rows = [line.split() for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]]
    return [(row[1].rpartition(":")[0], row[3]) for row in rows if row[9] in inodes]


def test_every_socket_of_a_session_is_tcp_on_loopback(hub: Bus, port: int) -> None:
    with Bus("lab", connect_port=port):
        addresses = {address for address, _ in _own_sockets("tcp")}
        listening = [address for address, state in _own_sockets("tcp") if state == "0A"]
        assert addresses == {"0100007F"}
        assert len(listening) == 2
        # Scouting would need a UDP socket; multicast has none elsewhere either.
        for table in ("tcp6", "udp", "udp6"):
            assert _own_sockets(table) == []


def test_the_configuration_names_no_other_interface() -> None:
    config = loopback_config(listen_port=1, connect_port=2)
    assert config["listen"]["endpoints"] == ["tcp/127.0.0.1:1"]
    assert config["connect"]["endpoints"] == ["tcp/127.0.0.1:2"]
    assert config["scouting"]["multicast"]["enabled"] is False


def test_an_answer_depends_on_the_question(hub: Bus, port: int) -> None:
    with Bus("lab", connect_port=port) as child:
        hub.answer_question("double", lambda question: 2 * question)
        hub.answer("plain", lambda: b"same")
        deadline = time.monotonic() + 120
        while child.ask("double", question=b"ab") != b"abab":
            assert time.monotonic() < deadline
        assert child.ask("double") == b""
        assert child.ask("plain", question=b"whatever") == b"same"
