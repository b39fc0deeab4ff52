"""One time axis for all cameras, and updates that hold every frame."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
from tests.server.recording.conftest import CAMERAS, MS, START_NS, info

from nearfield_server.recording.files.manifest import Manifest, TakeEntry
from nearfield_server.recording.files.timeline import Timeline, group_frames, make_timeline

MANIFEST = Manifest(
    kind="raw",
    room_name="room",
    software="test",
    boot_id="b",
    frame_rate=10.0,
    cameras=CAMERAS,
    takes=(TakeEntry(number=1, started_ns=START_NS, started_utc=""),),
)


def test_cameras_keep_their_distance_in_time_and_old_pictures_are_due_at_once() -> None:
    left = [info(5, START_NS - 3600 * 10**9), info(6, START_NS + 250 * MS)]
    right = [info(9, START_NS + 30 * MS), info(10, START_NS + 130 * MS)]
    line = make_timeline(MANIFEST, [left, right])
    assert line.due_ns == ((0, 250 * MS), (30 * MS, 130 * MS))
    assert line.duration_ns == 350 * MS


def test_a_picture_that_held_to_the_end_is_shown_to_the_end() -> None:
    ended = replace(MANIFEST, takes=(replace(MANIFEST.takes[0], ended_ns=START_NS + 7000 * MS),))
    assert make_timeline(ended, [[info(1, START_NS)], []]) == Timeline(((0,), ()), 7000 * MS)


def test_the_time_between_two_takes_is_left_out() -> None:
    takes = (*MANIFEST.takes, TakeEntry(number=2, started_ns=START_NS + 10**12, started_utc=""))
    frames = [info(1, START_NS + 5), info(1, START_NS + 10**12 + 40 * MS, take=2)]
    line = make_timeline(replace(MANIFEST, takes=takes), [frames])
    assert line.due_ns == ((0, 100 * MS),)
    assert line.duration_ns == 200 * MS


@given(st.lists(st.lists(st.integers(-500, 5000), max_size=12), min_size=1, max_size=4))
def test_every_frame_is_due_in_order_within_the_duration_and_in_exactly_one_update(
    times: list[list[int]],
) -> None:
    tracks = [[info(n, START_NS + t * MS) for n, t in enumerate(row, 1)] for row in times]
    line = make_timeline(MANIFEST, tracks)
    for row in line.due_ns:
        assert list(row) == sorted(row)
        assert all(0 <= due < line.duration_ns for due in row)
    updates = group_frames(line, 100 * MS)
    for camera, row in enumerate(line.due_ns):
        shown = [update[camera] for update in updates]
        first_shown = [
            index for number, index in enumerate(shown) if index is not None and index not in shown[:number]
        ]
        assert first_shown == list(range(len(row)))


def test_frames_of_one_moment_are_one_update() -> None:
    line = Timeline(((0, 100, 200), (3, 240)), 300)
    assert group_frames(line, 100) == [(0, 0), (1, 0), (2, 1)]
    assert group_frames(line, 60) == [(0, 0), (1, 0), (2, 0), (2, 1)]
