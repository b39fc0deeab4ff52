"""A running service for tests: started as users start it, observed on its bus and in /proc."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nearfield_protocol.codec import ClientMessage, LightPacket, decode_light_packet, encode_client_message
from nearfield_server.bus.keys import CONTROL_REQUEST
from nearfield_server.bus.session import Bus
from nearfield_server.scene.room_config import load_room
from nearfield_server.supervisor.launcher import free_loopback_port

TINY_ROOM = Path(__file__).parents[1] / "data" / "tiny_room"
TINY_NAME = "tiny"
PATIENCE_S = 120.0


class Service:
    """`nearfield serve` on the tiny room, and a bus session that listens to it."""

    def __init__(self, log_path: Path, *arguments: str, room: Path = TINY_ROOM, **environment: str) -> None:
        self.log_path, self.room = log_path, room
        self.bus_port = free_loopback_port()
        self._changed = threading.Condition()
        self._packets: list[tuple[float, LightPacket]] = []
        self._atlas: list[bytes] = []
        self._statuses: dict[str, dict[str, Any]] = {}
        self._log = log_path.open("wb")
        self.process = subprocess.Popen(
            [
                *(sys.executable, "-m", "nearfield_server", "serve", str(room)),
                *("--port", "0", "--bus-port", str(self.bus_port), *arguments),
            ],
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=subprocess.STDOUT,
            env={**os.environ, **environment},
        )
        self.bus = Bus(load_room(room).name, connect_port=self.bus_port)
        self.bus.subscribe("light/packet", self._take_packet)
        self.bus.subscribe("light/atlas", self._take_atlas)
        self.bus.subscribe("status/*", self._take_status)

    def _take_packet(self, _key: str, payload: bytes) -> None:
        with self._changed:
            self._packets.append((time.monotonic(), decode_light_packet(payload)))
            self._changed.notify_all()

    def _take_atlas(self, _key: str, payload: bytes) -> None:
        with self._changed:
            self._atlas.append(payload)
            self._changed.notify_all()

    def _take_status(self, key: str, payload: bytes) -> None:
        with self._changed:
            self._statuses[key.rpartition("/")[2]] = json.loads(payload)
            self._changed.notify_all()

    def log_text(self) -> str:
        """Everything the service printed."""
        return self.log_path.read_text(errors="replace")

    def wait(self, what: str, condition: Callable[[], Any]) -> Any:
        """Wait until `condition()` is true (checked after every message) and return its value."""
        with self._changed:
            end = time.monotonic() + PATIENCE_S
            while not (value := condition()):
                assert time.monotonic() < end, f"{what} did not happen; log:\n{self.log_text()[-6000:]}"
                self._changed.wait(0.1)
            return value

    def status(self, process: str, **fields: Any) -> dict[str, Any]:
        """Wait for a status with these fields and return it."""

        def matching() -> dict[str, Any] | None:
            status = self._statuses.get(process)
            return status if status and all(status.get(k) == v for k, v in fields.items()) else None

        found: dict[str, Any] = self.wait(f"status of {process} with {fields}", matching)
        return found

    def packet_after(self, since_s: float, **fields: Any) -> tuple[float, LightPacket]:
        """Wait for a light packet that arrives after a monotonic time and return it with its arrival time."""

        def newer() -> tuple[float, LightPacket] | None:
            found = [entry for entry in self._packets if entry[0] > since_s]
            return found[0] if found else None

        entry: tuple[float, LightPacket] = self.wait("a new light packet", newer)
        return entry

    def newest_packet(self) -> LightPacket:
        """The last light packet heard."""
        with self._changed:
            return self._packets[-1][1]

    def api_status(self) -> dict[str, Any]:
        """What `GET /api/status` says."""
        url = f"http://127.0.0.1:{self.status('supervisor')['port']}/api/status"
        with urllib.request.urlopen(url, timeout=PATIENCE_S) as answer:
            found: dict[str, Any] = json.load(answer)
        return found

    def picture_times(self) -> list[float]:
        """When the pictures that the light is made of were taken, per camera, in seconds of the illumination process's life.

        A still picture keeps its time, so a later time is a new picture. Waits until every camera has delivered one.
        """

        def taken() -> list[float] | None:
            status = self._statuses.get("illumination", {})
            ages = [camera["picture_age_s"] for camera in status.get("cameras", [])]
            return [status["uptime_s"] - age for age in ages] if ages and None not in ages else None

        times: list[float] = self.wait("a picture of every camera", taken)
        return times

    def settle(self, since: list[float] | None = None) -> LightPacket:
        """Wait until the light is made of pictures of all cameras, newer ones than `picture_times` gave if told so; return that light."""
        if since is not None:
            self.wait(
                "a new picture of every camera",
                lambda: all(new > old + 0.02 for new, old in zip(self.picture_times(), since, strict=True)),
            )
        # The update of the last picture may still run; packets are repeated every second.
        self.packet_after(time.monotonic())
        return self.packet_after(time.monotonic())[1]

    def request(self, message: ClientMessage) -> None:
        """Send what a gateway would send for a client."""
        self.bus.put(CONTROL_REQUEST, encode_client_message(message), must_arrive=True)

    def until(self, what: str, action: Callable[[], None], condition: Callable[[], Any]) -> Any:
        """Repeat `action()` until `condition()` holds: a message may come before its subscription."""
        end = time.monotonic() + PATIENCE_S
        while True:
            action()
            with self._changed:
                self._changed.wait_for(condition, timeout=1.0)
                if value := condition():
                    return value
            assert time.monotonic() < end, f"{what} did not happen; log:\n{self.log_text()[-6000:]}"

    def pid(self, process: str) -> int:
        """Process id of a part of the service; the supervisor knows those of its children."""
        if process == "launcher":
            return self.process.pid
        status = self.status("supervisor")
        return int(status["pid"] if process == "supervisor" else status["children"][process]["pid"])

    def running(self) -> dict[str, int]:
        """Wait until every process runs and return their ids."""

        def all_pids() -> dict[str, int] | None:
            supervisor = self._statuses.get("supervisor")
            if supervisor is None or supervisor["phase"] != "running":
                return None
            pids = {name: child["pid"] for name, child in supervisor["children"].items()}
            up = all(
                pid is not None
                and self._statuses.get(name, {}).get("pid") == pid
                and self._statuses[name]["phase"] == "running"
                for name, pid in pids.items()
            )
            return {**pids, "supervisor": supervisor["pid"]} if up else None

        found: dict[str, int] = self.wait("all processes running", all_pids)
        return found

    def spare(self) -> int:
        """Wait for a process in reserve and return its id."""
        pid: int = self.wait(
            "a process in reserve", lambda: self._statuses.get("supervisor", {}).get("spare_pid")
        )
        return pid

    def forget(self) -> None:
        """Drop all that was heard, so that only news counts."""
        with self._changed:
            self._statuses.clear()
            self._packets.clear()
            self._atlas.clear()

    def close(self) -> int:
        """End the service as systemd or Ctrl-C would and return its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(timeout=PATIENCE_S)
        self.bus.close()
        self._log.close()
        return code


def is_alive(pid: int) -> bool:
    """Whether a process exists and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_gone(pids: list[int]) -> None:
    """Wait until none of these processes exists."""
    end = time.monotonic() + 30
    while left := [pid for pid in pids if is_alive(pid)]:
        assert time.monotonic() < end, f"processes {left} outlived the service"
        time.sleep(0.02)


def open_files(pid: int) -> list[str]:
    """What a process has open, without numbers that differ from time to time."""
    files = []
    for fd in os.listdir(f"/proc/{pid}/fd"):
        try:
            files.append(os.readlink(f"/proc/{pid}/fd/{fd}").partition("[")[0].partition(":")[0])
        except FileNotFoundError:
            continue
    return sorted(files)


def child_pids(pid: int) -> list[int]:
    """Direct children of a process."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
