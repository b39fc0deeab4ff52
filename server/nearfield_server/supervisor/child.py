"""One child process: started, watched, ended."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import structlog

from nearfield_server.bus.worker import WorkerSpec
from nearfield_server.errors import ServiceError
from nearfield_server.supervisor.health import Health
from nearfield_server.supervisor.restart_policy import RestartPolicy
from nearfield_server.supervisor.spare import Spare

_log = structlog.get_logger("nearfield.supervisor")


def is_stopped(pid: int) -> bool:
    """Whether the system holds a process still after SIGSTOP; one that is gone is not."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    # The name of the program stands in parentheses and may contain anything.
    return stat.rpartition(")")[2].split()[0] == "T"


@dataclass(slots=True)
class Child:
    """A process of the service and everything the supervisor knows of it.

    Attributes:
        spec: what the process is told.
        module: what is run with `python -m`.
        pass_fds: file descriptors that it inherits.
        spare: where a process in reserve may wait for it.
        status: its newest status message.
        restarts: how often it was started again.
    """

    spec: WorkerSpec
    module: str
    pass_fds: tuple[int, ...] = ()
    spare: Spare | None = None
    health: Health = field(default_factory=Health)
    policy: RestartPolicy = field(default_factory=RestartPolicy)
    status: dict[str, Any] = field(default_factory=dict)
    restarts: int = 0
    last_fault: str = ""
    _process: subprocess.Popen[bytes] | None = None
    _start_at_s: float = 0.0

    @property
    def name(self) -> str:
        """Name on the bus."""
        return self.spec.process

    @property
    def pid(self) -> int | None:
        """Process id, or None while there is no process."""
        return None if self._process is None else self._process.pid

    def start(self, now_s: float) -> None:
        """Start the process; call it from the main thread, whose end is what the child's death signal watches.

        Raises:
            ServiceError: the system refuses another process.
        """
        try:
            self._process = self._take_spare(now_s) or subprocess.Popen(
                [sys.executable, "-m", self.module], stdin=subprocess.PIPE, pass_fds=self.pass_fds
            )
        except OSError as error:
            raise ServiceError(f"process {self.name} cannot be started: {error}") from error
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it died already: the next look at it will say so
            self._process.stdin.write(self.spec.to_json().encode() + b"\n")
            self._process.stdin.close()
        self.status = {}
        self.health.started(now_s)
        _log.info("process started", child=self.name, pid=self._process.pid)

    def _take_spare(self, now_s: float) -> subprocess.Popen[bytes] | None:
        return None if self.spare is None else self.spare.take(self.module, now_s)

    def watch(self, now_s: float) -> None:
        """Notice death and hanging; start again when it is time."""
        if self._process is None:
            if now_s >= self._start_at_s:
                self.restarts += 1
                self.start(now_s)
            return
        code = self._process.poll()
        if code is None:
            self.health.held_still(now_s, is_stopped(self._process.pid))
            fault = self.health.fault(now_s)
            if fault is None:
                return
            _log.warning("process hangs and is killed", child=self.name, pid=self._process.pid, reason=fault)
            self._process.kill()
            code = self._process.wait()
        else:
            fault = f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        delay_s, plan = self.policy.died(now_s)
        self.last_fault = fault
        self._process, self._start_at_s = None, now_s + delay_s
        _log.warning("process died", child=self.name, reason=fault, plan=plan)

    def hear(self, status: dict[str, Any], now_s: float) -> bool:
        """Take a status message from the bus; false if it is not of this process."""
        # Messages of a process that died may still be under way.
        if self.name != status.get("process") or self.pid != status.get("pid"):
            return False
        self.status = status
        self.health.status(now_s, str(status.get("phase")), float(status.get("beat_age_s", 0.0)))
        return True

    def has_ended(self) -> bool:
        """Whether there is no process any more."""
        return self._process is None or self._process.poll() is not None

    def terminate(self) -> None:
        """Ask the process to end."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()

    def finish(self, timeout_s: float) -> None:
        """Wait for the end; kill after `timeout_s` seconds."""
        if self._process is None:
            return
        try:
            self._process.wait(max(0.0, timeout_s))
        except subprocess.TimeoutExpired:
            _log.warning("process did not end and is killed", child=self.name, pid=self._process.pid)
            self._process.kill()
            self._process.wait()
        self._process = None

    def report(self) -> dict[str, Any]:
        """Return what the supervisor knows, for the status page."""
        return {
            "pid": self.pid,
            "restarts": self.restarts,
            "last_fault": self.last_fault,
            "module": self.module,
        }
