"""A process in reserve: one at a time, handed over once, gone with its owner."""

from __future__ import annotations

import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.service.harness import wait_gone

from nearfield_server.supervisor.spare import SETTLE_S, Spare

MODULE = "nearfield_server.capture.process"


@pytest.fixture
def spare() -> Iterator[Spare]:
    made = Spare(MODULE, ())
    yield made
    made.close()


def test_one_process_waits_and_is_handed_over_once(spare: Spare) -> None:
    assert spare.take(MODULE, 0.0) is None
    spare.watch(10.0)
    pid = spare.pid
    spare.watch(11.0)
    assert spare.pid == pid is not None
    assert spare.take("nearfield_server.gateway.process", 12.0) is None
    taken = spare.take(MODULE, 12.0)
    assert taken is not None
    assert taken.pid == pid
    assert taken.poll() is None
    spare.watch(12.0 + 0.5 * SETTLE_S)
    assert spare.pid is None
    spare.watch(12.0 + SETTLE_S)
    assert spare.pid not in (None, pid)
    # Without a specification it ends quietly.
    _, _ = taken.communicate(timeout=60)
    assert taken.returncode == 0


def test_a_dead_spare_is_replaced_later_and_a_closed_one_is_not(spare: Spare) -> None:
    spare.watch(0.0)
    first = spare._process
    assert first is not None
    first.kill()
    first.wait()
    assert spare.take(MODULE, 1.0) is None
    spare.watch(1.0)
    assert spare.pid is None
    spare.watch(1.0 + SETTLE_S)
    assert spare.pid is not None
    spare.close()
    spare.watch(1000.0)
    assert spare.pid is None


def test_a_spare_ends_with_its_owner_however_that_ends() -> None:
    script = f"""
        import time
        from nearfield_server.supervisor.spare import Spare
        spare = Spare({MODULE!r}, ())
        spare.watch(0.0)
        print(spare.pid, flush=True)
        time.sleep(1000)
    """
    owner = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script)], stdout=subprocess.PIPE, text=True
    )
    assert owner.stdout is not None
    pid = int(owner.stdout.readline())
    assert Path(f"/proc/{pid}").exists()
    time.sleep(0.1)
    owner.kill()
    owner.communicate()
    wait_gone([pid])
