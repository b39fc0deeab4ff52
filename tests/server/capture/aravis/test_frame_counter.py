"""Picture numbers: unwrapped, and losses counted, for any course of whole, broken and lost pictures."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.capture.aravis.frame_counter import FrameCounter, id_step


@pytest.mark.parametrize(
    ("last", "current", "step"),
    [
        (1, 2, 1),
        (7, 10, 3),
        (65535, 1, 1),
        (65534, 3, 4),
        (65535, 65536, 1),
        (1 << 40, (1 << 40) + 2, 2),
        (0, 1, 1),
        (500, 1, None),
        (7, 7, None),
        (1 << 40, 3, None),
        (70000, 1, None),
    ],
)
def test_steps(last: int, current: int, step: int | None) -> None:
    assert id_step(last, current) == step


def short_id(number: int) -> int:
    """Id of picture `number` (from 0) as GigE Vision 1 counts: 1 to 65535, and 1 again."""
    return number % 65535 + 1


courses = st.lists(st.sampled_from(["whole", "whole", "broken", "lost"]), max_size=60)


@given(courses, st.integers(0, 200_000), st.booleans())
def test_every_picture_between_two_whole_ones_is_counted_once(
    course: list[str], first: int, with_long_ids: bool
) -> None:
    course = ["whole", *course, "whole"]
    counter = FrameCounter()
    found = []
    for offset, fate in enumerate(course):
        number = first + offset
        if fate == "whole":
            found.append((offset, counter.whole(number if with_long_ids else short_id(number))))
        elif fate == "broken":
            counter.incomplete()
    assert counter.received == course.count("whole")
    assert counter.broken == course.count("broken")
    assert counter.lost == course.count("lost")
    assert all(number - found[0][1] == offset - found[0][0] for offset, number in found)


@given(st.lists(st.integers(0, (1 << 64) - 1), min_size=1, max_size=50))
def test_numbers_grow_whatever_the_device_says(ids: list[int]) -> None:
    counter = FrameCounter()
    numbers = [counter.whole(device_id) for device_id in ids]
    assert all(later > earlier for earlier, later in pairwise(numbers))
    assert counter.lost >= 0


def test_a_restart_loses_nothing() -> None:
    counter = FrameCounter()
    before = counter.whole(40)
    counter.restarted()
    assert counter.whole(1) == before + 1
    assert counter.lost == 0
