"""Frames that wait: never more than allowed, in order, and what the light was made of is the last to go."""

from __future__ import annotations

import threading

from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.recording.backlog import Backlog, WaitingFrame
from nearfield_server.recording.files.frame_info import FrameInfo

SHAPE = (2, 2, 4)
SIZE = 32


def _push(backlog: Backlog, camera: int, sequence: int) -> bool:
    frame_info = FrameInfo(take=1, sequence=sequence, content_revision=sequence, timestamp_ns=sequence)
    return backlog.push(WaitingFrame(camera, frame_info, backlog.buffer(SHAPE)))


def _drain(backlog: Backlog, cameras: tuple[int, ...] = (0, 1)) -> list[tuple[int, int]]:
    found = []
    while (frame := backlog.take(cameras, 0.0)) is not None:
        found.append((frame.camera, frame.info.sequence))
        backlog.done(frame.pixels)
    return found


@given(
    st.lists(
        st.tuples(st.sampled_from(["push0", "push1", "take", "use0", "use1"]), st.integers(0, 5)), max_size=60
    )
)
def test_whatever_happens_order_and_limit_hold_and_nothing_is_lost_uncounted(
    steps: list[tuple[str, int]],
) -> None:
    backlog = Backlog(4 * SIZE, 2)
    pushed, taken, next_sequence = [0, 0], [list[int](), list[int]()], [1, 1]
    for action, number in steps:
        camera = int(action[-1]) if action[-1].isdigit() else 0
        if action.startswith("push"):
            _push(backlog, camera, next_sequence[camera])
            next_sequence[camera] += 1
            pushed[camera] += 1
        elif action == "take":
            frame = backlog.take((0, 1), 0.0)
            if frame is not None:
                taken[frame.camera].append(frame.info.sequence)
        else:
            backlog.mark_used(camera, number)
        assert backlog.num_bytes <= backlog.max_bytes
        assert backlog.num_bytes == SIZE * backlog.num_frames
    for camera, sequence in _drain(backlog):
        taken[camera].append(sequence)
    for camera in range(2):
        assert taken[camera] == sorted(taken[camera])
        assert len(taken[camera]) + backlog.dropped[camera] == pushed[camera]


def test_frames_that_the_light_passed_over_make_room_first() -> None:
    backlog = Backlog(3 * SIZE, 2)
    for sequence in (1, 2, 3):
        assert _push(backlog, 0, sequence)
    backlog.mark_used(0, 1)
    backlog.mark_used(0, 3)  # 2 was passed over
    assert _push(backlog, 0, 4)
    assert not _push(backlog, 0, 5)  # 4 may still be used, 1 and 3 were
    assert _drain(backlog) == [(0, 1), (0, 3), (0, 4)]
    assert backlog.dropped == [2, 0]
    assert backlog.dropped_used == 0
    backlog.mark_used(0, 5)
    assert backlog.dropped_used == 1


def test_a_frame_larger_than_the_limit_still_goes_through_alone() -> None:
    backlog = Backlog(1, 1)
    assert _push(backlog, 0, 1)
    assert not _push(backlog, 0, 2)
    assert _drain(backlog, (0,)) == [(0, 1)]
    assert _push(backlog, 0, 3)


def test_a_writer_waits_for_its_own_cameras_and_ends_with_the_backlog() -> None:
    backlog = Backlog(10 * SIZE, 2)
    found: list[tuple[int, int]] = []

    def work() -> None:
        while (frame := backlog.take((1,), 30.0)) is not None:
            found.append((frame.camera, frame.info.sequence))

    writer = threading.Thread(target=work)
    writer.start()
    _push(backlog, 0, 1)
    _push(backlog, 1, 2)
    backlog.close()
    writer.join(timeout=30)
    assert not writer.is_alive()
    assert found == [(1, 2)]
    assert backlog.is_closed
    assert not _push(backlog, 1, 3)
    assert _drain(backlog) == [(0, 1)]


def test_memory_is_used_again() -> None:
    backlog = Backlog(10 * SIZE, 1)
    _push(backlog, 0, 1)
    frame = backlog.take((0,), 0.0)
    assert frame is not None
    backlog.done(frame.pixels)
    assert backlog.buffer(SHAPE) is frame.pixels
    assert backlog.buffer(SHAPE) is not frame.pixels
