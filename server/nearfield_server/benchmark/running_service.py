"""A service with all its processes, started as users start it, for measurements from outside."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from nearfield_server.errors import ServiceError

_ADDRESS: Final = re.compile(r"Nearfield is at (http://\S+/)")
# The first start of a room builds its geometry, which takes minutes on a busy machine.
_START_LIMIT_S: Final = 600.0
_STOP_LIMIT_S: Final = 30.0


@contextlib.contextmanager
def running_service(room: Path, *arguments: str) -> Iterator[str]:
    """Run `nearfield serve ROOM` on a free port of loopback.

    Args:
        room: as `nearfield serve` takes it.
        arguments: further options of it.

    Yields:
        The address of the page; the service answers there.

    Raises:
        ServiceError: the service ends or does not answer; carries what it said.
    """
    command = [sys.executable, "-m", "nearfield_server", "serve", str(room), "--port", "0", *arguments]
    with tempfile.TemporaryFile("w+b") as log:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        try:
            yield _wait_for_address(process, log.fileno())
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(timeout=_STOP_LIMIT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _wait_for_address(process: subprocess.Popen[bytes], log: int) -> str:
    end_s = time.monotonic() + _START_LIMIT_S
    while process.poll() is None and time.monotonic() < end_s:
        found = _ADDRESS.search(_text(log))
        if found is not None and _answers(found[1]):
            return found[1]
        time.sleep(0.1)
    state = "did not answer in time" if process.poll() is None else f"ended with code {process.returncode}"
    raise ServiceError(f"the service {state}; it said: {_text(log)[-2000:].strip()}")


def _text(log: int) -> str:
    # Read at a place, so that the position at which the service writes stays where it is.
    return os.pread(log, 1 << 20, 0).decode(errors="replace")


def _answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(f"{url}api/status", timeout=5.0) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False
