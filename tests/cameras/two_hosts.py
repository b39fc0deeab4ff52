"""Two hosts on one machine: the test's own network namespace, and another one at the other end of a cable (a veth pair)."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.cameras.harness import PATIENCE_S, wait_until

CLOCK_OFFSET_S = 86_400
"""The other host has been up for a day longer: its CLOCK_MONOTONIC is ahead by exactly this."""


class OtherHost:
    """A second host with a network, and a monotonic clock, of its own.

    Args:
        subnet: the first three numbers of the addresses; ours ends with 1, the other one's with 2.
    """

    def __init__(self, subnet: str) -> None:
        self.our_address, self.address = f"{subnet}.1", f"{subnet}.2"
        self._holder = subprocess.Popen(
            [_tool("unshare"), "--net", "--", sys.executable, "-c", "print(1, flush=True); input()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self._holder.stdout is not None
        assert self._holder.stdout.readline() == b"1\n"
        self._net = f"/proc/{self._holder.pid}/ns/net"
        self._ours = f"nf{self._holder.pid}"
        ip = _tool("ip")
        _run(ip, "link", "add", self._ours, "type", "veth", "peer", "eth0", "netns", str(self._holder.pid))
        _run(ip, "address", "add", f"{self.our_address}/24", "dev", self._ours)
        _run(ip, "link", "set", self._ours, "up")
        for command in ("address add {}/24 dev eth0", "link set lo up", "link set eth0 up"):
            self.run(ip, *command.format(self.address).split())

    def run(self, *command: str) -> None:
        """Run a command there to its end."""
        _run(_tool("nsenter"), f"--net={self._net}", "--", *command)

    def cut(self) -> None:
        """Pull the cable: what is sent is lost, and no connection is closed."""
        self.run(_tool("ip"), "link", "set", "eth0", "down")

    def mend(self) -> None:
        """Plug it in again; may be called twice."""
        self.run(_tool("ip"), "link", "set", "eth0", "up")

    def start(self, log: Path, *arguments: str) -> Process:
        """Start `nearfield ...` there."""
        return Process(
            log,
            [
                *(_tool("nsenter"), f"--net={self._net}", "--"),
                *(_tool("unshare"), "--time", "--monotonic", str(CLOCK_OFFSET_S), "--fork", "--kill-child"),
                *("--", sys.executable, "-m", "nearfield_server", *arguments),
            ],
        )

    def close(self) -> None:
        """Give the host back; the cable goes with it."""
        assert self._holder.stdin is not None
        assert self._holder.stdout is not None
        self._holder.kill()
        self._holder.wait(PATIENCE_S)
        self._holder.stdin.close()
        self._holder.stdout.close()


class Process:
    """A command that runs on the other host."""

    def __init__(self, log: Path, command: list[str]) -> None:
        self.log = log
        with log.open("ab") as file:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=file, stderr=file)

    def text(self) -> str:
        """What it has printed."""
        return self.log.read_text(errors="replace")

    def said(self, event: str, **fields: Any) -> dict[str, Any]:
        """Wait for a line of its log and return it."""

        def found() -> dict[str, Any] | None:
            for line in self.text().splitlines():
                entry = json.loads(line) if line.startswith("{") else {}
                if entry.get("event") == event and all(entry.get(key) == fields[key] for key in fields):
                    return dict(entry)
            return None

        entry: dict[str, Any] = wait_until(f"log line {event} {fields}", found)
        return entry

    def camera_pids(self) -> list[int]:
        """Process ids of the cameras, by what they run."""
        module = b"nearfield_server.capture.remote.node_camera"
        pids = []
        for pid in _descendants(self._process.pid):
            command = Path(f"/proc/{pid}/cmdline")
            if command.exists() and module in command.read_bytes():
                pids.append(pid)
        return pids

    def exit_code(self) -> int:
        """Wait for the end."""
        return self._process.wait(PATIENCE_S)

    def close(self) -> None:
        """End everything that was started, whatever state it is in."""
        for pid in self.camera_pids():
            os.kill(pid, signal.SIGCONT)
        for pid in reversed(_descendants(self._process.pid)):
            os.kill(pid, signal.SIGKILL)
        self._process.kill()
        self._process.wait(PATIENCE_S)


def _descendants(pid: int) -> list[int]:
    try:
        children = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except (FileNotFoundError, ProcessLookupError):
        return []
    return [found for child in children for found in (child, *_descendants(child))]


def _run(*command: str) -> None:
    subprocess.run(command, check=True, timeout=PATIENCE_S, capture_output=True)


def _tool(name: str) -> str:
    return shutil.which(name) or f"/usr/sbin/{name}"
