"""When a process that exists counts as hanging."""

from __future__ import annotations

import pytest

from nearfield_server.supervisor.health import Health


@pytest.fixture
def health() -> Health:
    health = Health()
    health.started(100.0)
    return health


def test_a_process_has_time_to_start_but_not_for_ever(health: Health) -> None:
    assert health.fault(100.0 + health.start_limit_s) is None
    assert "no status within" in (health.fault(100.1 + health.start_limit_s) or "")
    assert not health.is_running(100.0)


def test_silence_after_the_first_status_is_a_fault(health: Health) -> None:
    health.status(101.0, "running", 0.0)
    assert health.fault(101.0 + health.silent_limit_s) is None
    assert "no status for" in (health.fault(101.1 + health.silent_limit_s) or "")


def test_a_lost_token_makes_silence_shorter_and_alone_is_no_fault(health: Health) -> None:
    health.status(101.0, "running", 0.0)
    health.token(False)
    assert health.fault(101.5) is None
    assert "token lost" in (health.fault(101.1 + health.lost_limit_s) or "")
    health.token(True)
    assert health.fault(101.1 + health.lost_limit_s) is None


def test_a_loop_that_stands_still_is_a_fault_although_status_comes(health: Health) -> None:
    for second in range(20):
        health.status(101.0 + second, "running", float(second))
    assert "stands still" in (health.fault(120.0) or "")
    assert not health.is_running(120.0)


def test_preparing_may_take_minutes(health: Health) -> None:
    health.status(200.0, "starting", 100.0)
    assert health.fault(200.0) is None
    health.status(900.0, "starting", health.preparing_limit_s + 1)
    assert "stands still" in (health.fault(900.0) or "")


def test_a_preparing_process_may_be_silent_for_as_long_as_a_starting_one(health: Health) -> None:
    health.status(101.0, "starting", 0.0)
    health.token(False)
    assert health.fault(101.0 + health.start_limit_s) is None
    assert "no status for" in (health.fault(101.1 + health.start_limit_s) or "")


def test_a_new_process_is_judged_afresh(health: Health) -> None:
    health.status(101.0, "running", 0.0)
    health.token(False)
    assert health.fault(150.0) is not None
    health.started(150.0)
    assert health.fault(151.0) is None
    assert not health.is_running(151.0)
    health.status(151.0, "running", 0.0)
    assert health.is_running(151.0)


def test_a_process_that_the_system_holds_still_is_frozen_and_one_that_goes_on_is_not(health: Health) -> None:
    health.status(101.0, "running", 0.0)
    health.held_still(101.0, is_stopped=True)
    health.held_still(102.0, is_stopped=True)
    assert health.fault(102.0) is None
    assert "stopped by a signal for 1.6 s" in (health.fault(102.6) or "")
    health.held_still(102.6, is_stopped=False)
    health.held_still(102.7, is_stopped=True)
    assert health.fault(102.8) is None
