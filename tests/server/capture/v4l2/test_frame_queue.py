from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.capture.v4l2.frame_queue import SequenceCounter


@given(start=st.integers(0, 2**32 - 1), steps=st.lists(st.integers(1, 1000), max_size=50))
def test_every_gap_is_counted_across_the_wrap(start: int, steps: list[int]) -> None:
    counter, sequence = SequenceCounter(), start
    first = counter.unwrap(sequence)
    for step in steps:
        sequence = (sequence + step) % 2**32
        counter.unwrap(sequence)
    assert counter.lost == sum(steps) - len(steps)
    assert counter.unwrap((sequence + 1) % 2**32) - first == sum(steps) + 1


def test_drivers_that_do_not_count_or_start_again_lose_nothing() -> None:
    counter = SequenceCounter()
    assert [counter.unwrap(sequence) for sequence in (0, 0, 0)] == [0, 1, 2]
    assert [counter.unwrap(sequence) for sequence in (500, 3, 4)] == [502, 503, 504]
    assert counter.lost == 499


def test_numbers_go_on_over_a_restart() -> None:
    counter = SequenceCounter()
    counter.unwrap(10)
    counter.restart()
    assert counter.unwrap(0) == 1
    assert counter.lost == 0
