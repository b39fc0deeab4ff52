"""When to stop before the disk is full, and what is said before."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.recording.space import (
    DiskSpace,
    SpaceGuard,
    WriteRate,
    disk_space,
    most_bytes_per_second,
)


def test_four_cameras_of_a_megapixel_at_ten_frames() -> None:
    assert most_bytes_per_second([(1024, 1024)] * 4, 10.0) == 4 * 1024 * 1024 * 8 * 10


def test_the_disk_is_looked_at_through_parents_that_exist(tmp_path: Path) -> None:
    space = disk_space(tmp_path / "not" / "there" / "yet")
    assert 0 < space.free <= space.total


@given(st.lists(st.tuples(st.floats(0.0, 3.0), st.integers(0, 10**9)), min_size=1, max_size=30))
def test_the_rate_is_what_was_written_over_the_last_seconds(entries: list[tuple[float, int]]) -> None:
    rate, now_s, written = WriteRate(), 100.0, []
    for wait_s, size in entries:
        now_s += wait_s
        rate.add(now_s, size)
        written.append((now_s, size))
    recent = [(at_s, size) for at_s, size in written if now_s - at_s <= 5.0]
    span_s = max(0.5, now_s - recent[0][0])
    assert rate.per_second(now_s) == pytest.approx(sum(size for _, size in recent) / span_s)
    assert rate.per_second(now_s + 6.0) == 0.0


def test_it_stops_while_the_reserve_is_still_free(tmp_path: Path) -> None:
    free = [10_000]
    guard = SpaceGuard(tmp_path, 4000, lambda _: DiskSpace(free[0], 10**6))
    assert not guard.is_low(0.0, 0.0)
    assert guard.free(0.1, 3000) == 7000  # counted between two looks
    free[0] = 4500
    assert not guard.is_low(1.0, 0.0)
    assert guard.minutes_left(1.0, 100.0) == pytest.approx(500 / 100 / 60)
    assert guard.minutes_left(1.0, 0.0) is None
    free[0] = 3999
    assert guard.is_low(2.0, 0.0)
    assert guard.minutes_left(2.0, 100.0) == 0.0


def test_the_reserve_follows_the_rate_and_the_size_of_the_disk(tmp_path: Path) -> None:
    large = SpaceGuard(tmp_path, None, lambda _: DiskSpace(10**12, 10**13))
    assert large.reserve(0.0) == 500_000_000
    assert large.reserve(2e8) == 2_000_000_000
    small = SpaceGuard(tmp_path, None, lambda _: DiskSpace(10**8, 10**8))
    assert small.reserve(0.0) == 5_000_000
    assert small.reserve(1e9) == 10_000_000
    assert SpaceGuard(tmp_path, 7, lambda _: DiskSpace(10**8, 10**8)).reserve(1e9) == 7
