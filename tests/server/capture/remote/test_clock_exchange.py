"""Whatever the network does, the true offset lies within the stated error; nothing else is promised."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.capture.remote.clock_exchange import DRIFT_LIMIT, ClockExchange

MS = 1_000_000
delays = st.integers(0, 200 * MS)


@given(
    st.integers(-(10**18), 10**18),
    st.floats(-0.9 * DRIFT_LIMIT, 0.9 * DRIFT_LIMIT),
    st.lists(st.tuples(delays, delays, delays, st.integers(0, 2000 * MS)), min_size=1, max_size=30),
)
def test_the_true_offset_lies_within_the_error(
    offset: int, drift: float, exchanges: list[tuple[int, int, int, int]]
) -> None:
    def theirs(ours: int) -> int:
        return ours - offset - int(drift * ours)

    clock, now = ClockExchange(), 0
    for there, thinking, back, pause in exchanges:
        now += pause
        received = now + there
        answered = received + thinking
        heard = answered + back
        assert clock.add(now, theirs(received), theirs(answered), heard)
        now = heard
        estimate = clock.offset(now)
        assert estimate is not None
        middle, error = estimate
        truth = now - theirs(now)
        assert abs(middle - truth) <= error + 2  # whole nanoseconds
        # Half the way there and back bounds the error; thinking time and older, worse exchanges do not matter.
        assert error <= (there + back) / 2 + DRIFT_LIMIT * (there + thinking + back) * 2 + 4
    assert clock.restarts == 0


def test_a_quick_exchange_is_remembered_and_ages_with_the_drift() -> None:
    clock = ClockExchange()
    clock.add(0, 1000 * MS, 1000 * MS, 2 * MS)
    first = clock.offset(2 * MS)
    assert first is not None
    assert abs(first[0] + 999 * MS) <= 1
    assert MS <= first[1] <= MS * (1 + 2 * DRIFT_LIMIT) + 2
    for at in range(1, 11):
        clock.add(at * 1000 * MS, (at + 1) * 1000 * MS, (at + 1) * 1000 * MS, (at * 1000 + 400) * MS)
    found = clock.offset(10_400 * MS)
    assert found is not None
    assert found[1] <= MS + int(10_400 * MS * DRIFT_LIMIT) + 2


def test_impossible_exchanges_are_refused() -> None:
    clock = ClockExchange()
    assert not clock.add(10, 0, 0, 9)  # heard before asked
    assert not clock.add(0, 10, 9, 100)  # answered before received
    assert not clock.add(0, 10, 200, 100)  # thought for longer than everything took
    assert clock.offset(0) is None


def test_a_clock_that_jumped_starts_anew() -> None:
    clock = ClockExchange()
    clock.add(0, 50, 50, 100)
    clock.add(1000 * MS, 5000 * MS, 5000 * MS, 1001 * MS)
    assert clock.restarts == 1
    found = clock.offset(1001 * MS)
    assert found is not None
    assert abs(found[0] - -3999_500_000) <= found[1]
