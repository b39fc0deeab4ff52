"""A process in reserve: started and imported, it waits for its specification, so that a dead camera process is replaced at once.

Importing the compiler of the kernels takes most of a second; a picture comes a few tenths of a second after that.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass

import structlog

SETTLE_S = 3.0
"""A new spare is made only when the process that took the last one has had this time to itself, seconds."""

_log = structlog.get_logger("nearfield.supervisor")


@dataclass(slots=True)
class Spare:
    """Keeps one process in reserve for several children that run the same module.

    Attributes:
        module: what the process runs; it does nothing before it has read a line from its standard input.
        pass_fds: file descriptors of all those children; the process keeps those that its specification names.
    """

    module: str
    pass_fds: tuple[int, ...]
    _process: subprocess.Popen[bytes] | None = None
    _start_at_s: float = 0.0

    @property
    def pid(self) -> int | None:
        """Process id of the spare, or None while there is none."""
        return None if self._process is None else self._process.pid

    def wait(self, now_s: float) -> None:
        """Make the first spare only some time after `now_s`: what has just started has the machine to itself."""
        self._start_at_s = now_s + SETTLE_S

    def watch(self, now_s: float) -> None:
        """Keep a spare in reserve; call it now and then from the main thread, whose end is what the process's death signal watches."""
        if self._process is not None and self._process.poll() is not None:
            self._drop()
            self._start_at_s = now_s + SETTLE_S
        if self._process is None and now_s >= self._start_at_s:
            try:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", self.module], stdin=subprocess.PIPE, pass_fds=self.pass_fds
                )
            except OSError as error:
                _log.warning("no process in reserve", reason=str(error))
                self._start_at_s = now_s + SETTLE_S

    def take(self, module: str, now_s: float) -> subprocess.Popen[bytes] | None:
        """Hand the spare over to a child that runs `module`; None if there is none that fits."""
        process = self._process
        if process is None or module != self.module or process.poll() is not None:
            return None
        self._process, self._start_at_s = None, now_s + SETTLE_S
        return process

    def close(self) -> None:
        """End the spare, and make no other."""
        self._start_at_s = float("inf")
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._drop()

    def _drop(self) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process = None
