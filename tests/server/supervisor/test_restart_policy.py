"""Restarts: the first at once, a burst slower, five a minute put to rest."""

from __future__ import annotations

import random

from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.supervisor.restart_policy import RestartPolicy


def test_a_single_death_is_answered_at_once_every_time() -> None:
    policy = RestartPolicy()
    for death in range(10):
        assert policy.died(death * 61.0)[0] == 0.0


def test_five_deaths_within_a_minute_mean_a_rest_and_say_why() -> None:
    policy = RestartPolicy()
    answers = [policy.died(float(death)) for death in range(5)]
    assert all(delay < policy.rest_s for delay, _ in answers[:4])
    delay, reason = answers[4]
    assert delay == policy.rest_s
    assert "5 deaths within 60 s" in reason


@given(st.lists(st.floats(0, 200), max_size=30), st.integers())
def test_delays_are_never_negative_and_at_most_the_rest(gaps: list[float], seed: int) -> None:
    policy = RestartPolicy(rng=random.Random(seed))
    now_s = 0.0
    deaths: list[float] = []
    for gap in gaps:
        now_s += gap
        deaths.append(now_s)
        delay_s, _ = policy.died(now_s)
        recent = sum(now_s - death <= policy.window_s for death in deaths)
        assert 0 <= delay_s <= policy.rest_s
        assert (delay_s == policy.rest_s) == (recent >= policy.max_deaths)
