"""The launcher holds the terminal and the supervisor's life: it starts it again when it is killed, and passes signals on."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from types import FrameType

from nearfield_server.supervisor.restart_policy import RestartPolicy
from nearfield_server.supervisor.settings import ServiceSettings

_STOP_LIMIT_S = 5.0


def free_loopback_port() -> int:
    """Return a TCP port of 127.0.0.1 that nobody listens on at the moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


class Launcher:
    """Runs one service in the foreground."""

    def __init__(self, settings: ServiceSettings) -> None:
        self._settings = replace(settings, launcher_pid=os.getpid())
        self._process: subprocess.Popen[bytes] | None = None
        self._stopping = False

    def run(self) -> int:
        """Run until the supervisor ends by itself or a signal ends the service.

        Returns:
            The exit code: 0 after a signal, otherwise the supervisor's.
        """
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._forward)
        policy = RestartPolicy()
        while True:
            code = self._run_supervisor()
            if self._stopping:
                return 0
            if code >= 0:
                return code
            delay_s, plan = policy.died(time.monotonic())
            sys.stderr.write(f"nearfield: supervisor killed by {signal.Signals(-code).name}; {plan}\n")
            end_s = time.monotonic() + delay_s
            while time.monotonic() < end_s and not self._stopping:
                time.sleep(0.05)
            if self._stopping:
                return 0

    def _run_supervisor(self) -> int:
        # A session of its own: Ctrl-C in the terminal reaches the launcher alone, which passes it on once.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "nearfield_server.supervisor"],
            stdin=subprocess.PIPE,
            start_new_session=True,
        )
        if self._stopping:  # the signal came while the process was being made
            self._process.terminate()
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(self._settings.to_json().encode() + b"\n")
            self._process.stdin.close()
        except BrokenPipeError:
            pass  # it died already; its exit code says how
        return self._process.wait()

    def _forward(self, _number: int, _frame: FrameType | None) -> None:
        self._stopping = True
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            # A supervisor that does not obey is ended; its children die with it.
            signal.signal(signal.SIGALRM, self._kill)
            signal.setitimer(signal.ITIMER_REAL, _STOP_LIMIT_S)

    def _kill(self, _number: int, _frame: FrameType | None) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
