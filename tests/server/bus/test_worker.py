"""Life of a child process: specification, heartbeat, control state, end."""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from nearfield_server.bus.backoff import Backoff
from nearfield_server.bus.keys import CONTROL_STATE
from nearfield_server.bus.messages import ControlState
from nearfield_server.bus.session import Bus
from nearfield_server.bus.worker import WorkerSpec
from nearfield_server.errors import ServiceError

CHILD = """
from nearfield_server.bus.worker import run_worker
from nearfield_server.errors import CaptureError
def main(worker):
    state = worker.wait_for_control(20)
    if worker.spec.options.get("fail"):
        raise CaptureError("no such camera")
    while not worker.stop.is_set():
        worker.beat(weights=list(worker.control.light_weights))
        worker.stop.wait(0.01)
run_worker(main)
"""


class _Statuses:
    def __init__(self) -> None:
        self._seen: list[dict[str, Any]] = []
        self._changed = threading.Condition()

    def __call__(self, _key: str, payload: bytes) -> None:
        with self._changed:
            self._seen.append(json.loads(payload))
            self._changed.notify_all()

    def wait(self, **fields: Any) -> bool:
        def matches() -> bool:
            return any(all(s.get(k) == v for k, v in fields.items()) for s in self._seen)

        with self._changed:
            return self._changed.wait_for(matches, timeout=120)


@pytest.fixture
def hub() -> Iterator[tuple[Bus, int]]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with Bus("lab", listen_port=port) as bus:
        yield bus, port


def _spec(port: int, **options: Any) -> WorkerSpec:
    return WorkerSpec(
        process="cam0",
        room_path="/r",
        room_name="lab",
        bus_port=port,
        supervisor_pid=os.getpid(),
        options=options,
    )


def _start(spec: WorkerSpec) -> subprocess.Popen[str]:
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD], stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdin is not None
    child.stdin.write(spec.to_json() + "\n")
    child.stdin.flush()
    return child


def _state(revision: int, weight: float) -> bytes:
    return ControlState(revision=revision, light_weights=(weight,), objects=()).to_json()


def test_a_worker_asks_for_the_state_follows_it_and_stops_cleanly(hub: tuple[Bus, int]) -> None:
    bus, port = hub
    statuses = _Statuses()
    bus.subscribe("status/*", statuses)
    bus.answer(CONTROL_STATE, lambda: _state(4, 0.5))
    child = _start(_spec(port))
    try:
        assert statuses.wait(process="cam0", pid=child.pid, phase="running", weights=[0.5])
        bus.put(CONTROL_STATE, _state(3, 9.0), must_arrive=True)  # late news
        bus.put(CONTROL_STATE, b"nonsense", must_arrive=True)
        bus.put(CONTROL_STATE, _state(5, 0.25), must_arrive=True)
        assert statuses.wait(weights=[0.25])
        assert not any(status.get("weights") == [9.0] for status in statuses._seen)
        child.send_signal(signal.SIGTERM)
        assert child.wait(timeout=120) == 0
    finally:
        child.kill()
        child.communicate()


def test_a_deliberate_error_is_one_line_and_exit_code_3(hub: tuple[Bus, int]) -> None:
    bus, port = hub
    bus.answer(CONTROL_STATE, lambda: _state(1, 1.0))
    child = _start(_spec(port, fail=True))
    _, errors = child.communicate(timeout=60)
    assert child.returncode == 3
    assert "Traceback" not in errors
    line = json.loads(errors.strip().splitlines()[-1])
    assert (line["process"], line["reason"]) == ("cam0", "no such camera")


def test_a_worker_dies_with_its_parent() -> None:
    parent_code = """
import os, subprocess, sys
child = subprocess.Popen([sys.executable, "-c",
    "import os, time\\nfrom nearfield_server.bus.worker import die_with_parent\\n"
    "die_with_parent(os.getppid())\\nprint(os.getpid(), flush=True)\\ntime.sleep(600)"], stdout=subprocess.PIPE, text=True)
print(child.stdout.readline(), flush=True)
import time; time.sleep(600)
"""
    parent = subprocess.Popen([sys.executable, "-c", parent_code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    os.kill(pid, 0)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    for _ in range(600):
        try:
            with open(f"/proc/{pid}/stat", encoding="ascii") as file:
                if file.read().rpartition(")")[2].split()[0] == "Z":
                    return  # dead; only its entry waits for whoever inherited it
        except FileNotFoundError:
            return
        time.sleep(0.05)
    os.kill(pid, signal.SIGKILL)
    raise AssertionError("the child outlived its parent")


def test_specifications_pass_through_json_and_others_are_refused() -> None:
    spec = _spec(7, camera_index=1)
    assert WorkerSpec.from_json(spec.to_json()) == spec
    for line in ("", "[]", "{}", '{"ring_fds": []}'):
        with pytest.raises(ServiceError, match="not by hand"):
            WorkerSpec.from_json(line)


def test_backoff_doubles_up_to_its_maximum_and_starts_again() -> None:
    backoff = Backoff(initial_s=0.5, maximum_s=10.0, rng=random.Random(1))
    delays = [backoff.next_delay() for _ in range(40)]
    for attempt, delay in enumerate(delays):
        nominal = min(10.0, 0.5 * 2**attempt)
        assert 0.75 * nominal <= delay <= 1.25 * nominal
    assert len({round(delay, 9) for delay in delays[10:]}) > 20
    backoff.reset()
    assert backoff.next_delay() <= 0.625
