"""Whatever dies, light comes back and nothing is left behind."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.service.harness import Service, child_pids, is_alive, open_files, wait_gone

pytestmark = pytest.mark.service


@pytest.fixture
def shared_memory() -> list[str]:
    return sorted(os.listdir("/dev/shm"))


@pytest.mark.parametrize("victim", ["cam0", "cam1", "illumination", "gateway"])
def test_a_killed_process_is_replaced_and_light_goes_on(
    service: Service, victim: str, shared_memory: list[str], record_property: Callable[[str, object], None]
) -> None:
    before = service.running()
    service.spare()
    files = open_files(before["supervisor"])
    service.forget()
    killed_s = time.monotonic()
    os.kill(before[victim], signal.SIGKILL)
    service.wait(
        "a new process",
        lambda: service._statuses.get(victim, {}).get("pid", before[victim]) != before[victim],
    )
    after = service.running()
    back_s, _ = service.packet_after(killed_s)
    record_property("seconds_to_packet", round(back_s - killed_s, 2))
    assert after[victim] != before[victim]
    assert {name: pid for name, pid in after.items() if name != victim} == {
        name: pid for name, pid in before.items() if name != victim
    }
    spare = service.spare()
    assert sorted(child_pids(after["supervisor"])) == sorted(
        [spare, *(pid for name, pid in after.items() if name != "supervisor")]
    )
    service.wait("the same open files", lambda: open_files(after["supervisor"]) == files)
    assert open_files(after["supervisor"]).count("/memfd") == files.count("/memfd")
    assert sorted(os.listdir("/dev/shm")) == shared_memory
    cameras = service.wait(
        "fresh cameras",
        lambda: [c for c in service._statuses.get("illumination", {}).get("cameras", []) if not c["stale"]][
            1:
        ],
    )
    assert cameras


def test_a_frozen_process_is_killed_and_replaced(service: Service) -> None:
    before = service.running()
    service.forget()
    os.kill(before["cam0"], signal.SIGSTOP)
    service.wait(
        "a new process",
        lambda: service._statuses.get("cam0", {}).get("pid", before["cam0"]) != before["cam0"],
    )
    service.running()
    assert not is_alive(before["cam0"])
    assert "process hangs and is killed" in service.log_text()


def test_a_dead_camera_leaves_its_light_and_is_marked_stale(service: Service) -> None:
    pids = service.running()
    os.kill(pids["cam1"], signal.SIGSTOP)
    try:
        service.forget()
        service.wait(
            "staleness",
            lambda: (
                service._statuses.get("illumination", {}).get("stale")
                and service._statuses["illumination"]["cameras"][1]["stale"]
            ),
        )
        assert not service._statuses["illumination"]["cameras"][0]["stale"]
        _, packet = service.packet_after(time.monotonic())
        assert packet.object_sh[0, 0].min() > 0
    finally:
        if is_alive(pids["cam1"]):
            os.kill(pids["cam1"], signal.SIGCONT)
    service.forget()
    service.running()


def test_a_killed_supervisor_is_replaced_with_all_its_processes(
    start_service: Callable[..., Service],
    shared_memory: list[str],
    record_property: Callable[[str, object], None],
) -> None:
    service = start_service()
    before = service.running()
    service.forget()
    killed_s = time.monotonic()
    os.kill(before["supervisor"], signal.SIGKILL)
    wait_gone(list(before.values()))
    back_s, _ = service.packet_after(killed_s)
    record_property("seconds_to_packet", round(back_s - killed_s, 2))
    after = service.running()
    assert not set(after.values()) & set(before.values())
    assert sorted(child_pids(service.process.pid)) == [after["supervisor"]]
    assert sorted(os.listdir("/dev/shm")) == shared_memory


def test_a_killed_launcher_takes_everything_with_it(start_service: Callable[..., Service]) -> None:
    service = start_service()
    pids = service.running()
    service.process.kill()
    service.process.wait()
    wait_gone(list(pids.values()))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_service_cleanly(
    start_service: Callable[..., Service],
    shared_memory: list[str],
    number: signal.Signals,
    tmp_path: Path,
    record_property: Callable[[str, object], None],
) -> None:
    """Told to end by a person or by systemd, which is told about it in turn."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60)
        service = start_service(NOTIFY_SOCKET=str(tmp_path / "notify"))
        assert manager.recv(100) == b"READY=1"
        assert manager.recv(100) == b"WATCHDOG=1"
        _end_and_look(service, shared_memory, number, record_property)
        manager.setblocking(False)
        while (message := manager.recv(100)) != b"STOPPING=1":
            assert message == b"WATCHDOG=1"


def _end_and_look(
    service: Service,
    shared_memory: list[str],
    number: signal.Signals,
    record_property: Callable[[str, object], None],
) -> None:
    pids = service.running()
    asked_s = time.monotonic()
    service.process.send_signal(number)
    assert service.process.wait(timeout=60) == 0
    record_property("seconds_to_end", round(time.monotonic() - asked_s, 2))
    wait_gone(list(pids.values()))
    assert sorted(os.listdir("/dev/shm")) == shared_memory
    log = service.log_text()
    assert "Traceback" not in log
    assert "did not end and is killed" not in log


def test_only_loopback_is_listened_on(service: Service) -> None:
    pids = service.running()
    inodes = {}
    for name, pid in pids.items():
        for fd in os.listdir(f"/proc/{pid}/fd"):
            target = os.readlink(f"/proc/{pid}/fd/{fd}")
            if target.startswith("socket:["):
                inodes[target[8:-1]] = name
    for table in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            row = line.split()
            if row[9] in inodes:
                address = row[1].rpartition(":")[0]
                assert (table, address) == ("tcp", "0100007F"), f"{inodes[row[9]]} has {table} {row[1]}"
