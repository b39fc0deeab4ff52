"""Laws of the frame ring: newest whole frame, never a torn one, whatever happens to the writer."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.frame_signal import FrameSignal
from nearfield_server.capture.ring_memory import COUNTER_NAMES, RingShape, create_ring

SHAPE = RingShape(6, 5, 3)
GRID = RingShape(70, 100, 3)


@pytest.fixture
def make_ring() -> Iterator[Callable[[RingShape], int]]:
    fds: list[int] = []

    def make(shape: RingShape = SHAPE) -> int:
        fds.append(create_ring("test", shape))
        return fds[-1]

    yield make
    for fd in fds:
        os.close(fd)


def _write(writer: FrameRingWriter, value: float, revision: int = 1, timestamp_ns: int = 1) -> None:
    with writer.write(revision, timestamp_ns) as draft:
        draft.pixels[...] = value
        draft.counters[...] = range(len(COUNTER_NAMES))


def _die_while_writing(writer: FrameRingWriter) -> None:
    with writer.write(1, 2) as draft:
        draft.pixels[:3] = 99
        raise KeyboardInterrupt


def test_empty_ring_has_no_frame(make_ring: Callable[..., int]) -> None:
    fd = make_ring()
    reader = FrameRingReader(fd, "test", SHAPE)
    assert reader.newest() is None
    assert reader.newest_copy(0) is None
    assert reader.confirmed_ns == 0


def test_reader_sees_the_newest_frame_with_all_its_fields(make_ring: Callable[..., int]) -> None:
    fd = make_ring()
    writer, reader = FrameRingWriter(fd, "test", SHAPE), FrameRingReader(fd, "test", SHAPE)
    for index in range(1, 8):
        _write(writer, index, revision=index, timestamp_ns=100 * index)
        view = reader.newest()
        assert view is not None
        assert (view.sequence, view.timestamp_ns, view.confirmed_ns) == (index, 100 * index, 100 * index)
        assert view.counters == {name: number for number, name in enumerate(COUNTER_NAMES)}
        np.testing.assert_array_equal(view.pixels, np.full((6, 5, 4), index, np.float16))
        assert view.still_valid()
        copy = reader.newest_copy(2)
        assert copy is not None
        assert (copy.camera_index, copy.sequence, copy.content_revision) == (2, index, view.content_revision)
        np.testing.assert_array_equal(copy.pixels, view.pixels)


def test_reader_cannot_write(make_ring: Callable[..., int]) -> None:
    fd = make_ring()
    _write(FrameRingWriter(fd, "test"), 1)
    view = FrameRingReader(fd, "test").newest()
    assert view is not None
    with pytest.raises(ValueError, match="read-only"):
        view.pixels[0, 0, 0] = 3


@given(overtaken_by=st.integers(0, 7))
@settings(max_examples=8, deadline=None)
def test_a_view_is_valid_exactly_until_its_slot_comes_round(overtaken_by: int) -> None:
    fd = create_ring("test", SHAPE)
    try:
        writer, reader = FrameRingWriter(fd, "test"), FrameRingReader(fd, "test")
        _write(writer, 1)
        view = reader.newest()
        assert view is not None
        for _ in range(overtaken_by):
            _write(writer, 2)
        assert view.still_valid() == (overtaken_by < SHAPE.slot_count)
    finally:
        os.close(fd)


def test_a_frame_abandoned_in_the_middle_is_never_shown_and_its_slot_is_used_again(
    make_ring: Callable[..., int],
) -> None:
    fd = make_ring()
    writer, reader = FrameRingWriter(fd, "test"), FrameRingReader(fd, "test")
    _write(writer, 1)
    for _ in range(3 * SHAPE.slot_count):  # each attempt dies; a new writer takes over each time
        with pytest.raises(KeyboardInterrupt):
            _die_while_writing(FrameRingWriter(fd, "test"))
        view = reader.newest()
        assert view is not None
        assert view.sequence == 1
        assert (view.pixels == 1).all()
    _write(FrameRingWriter(fd, "test"), 2)
    view = reader.newest()
    assert view is not None
    assert view.sequence == 2
    assert (view.pixels == 2).all()


def test_content_revisions_of_different_writers_differ(make_ring: Callable[..., int]) -> None:
    fd = make_ring()
    reader = FrameRingReader(fd, "test")
    revisions = []
    for generation in range(1, 4):
        writer = FrameRingWriter(fd, "test")
        _write(writer, 1, revision=1)
        view = reader.newest()
        assert view is not None
        assert reader.generation == generation
        revisions.append(view.content_revision)
    assert len(set(revisions)) == 3


def test_confirming_keeps_the_picture_and_renews_its_age(make_ring: Callable[..., int]) -> None:
    fd = make_ring()
    writer, reader = FrameRingWriter(fd, "test"), FrameRingReader(fd, "test")
    _write(writer, 1, timestamp_ns=10)
    before = reader.newest()
    writer.confirm(500)
    after = reader.newest()
    assert before is not None
    assert after is not None
    assert before.still_valid()
    assert (after.sequence, after.content_revision, after.timestamp_ns) == (
        before.sequence,
        before.content_revision,
        10,
    )
    assert after.confirmed_ns == reader.confirmed_ns == 500


def test_the_revision_of_a_tile_is_that_of_the_frame_that_changed_it_last(
    make_ring: Callable[..., int],
) -> None:
    fd = make_ring(GRID)
    reader = FrameRingReader(fd, "test")
    rng = np.random.default_rng(3)
    expected = np.zeros(GRID.tile_grid, np.int64)
    writer = FrameRingWriter(fd, "test")
    revision = 0
    for step in range(60):
        if step % 20 == 19:  # a new writer goes on with the tiles that it finds
            writer, revision = FrameRingWriter(fd, "test"), 0
        revision += 1
        changed = rng.random(GRID.tile_grid) < 0.3 if step else np.ones(GRID.tile_grid, bool)
        with writer.write(revision, step) as draft:
            assert draft.changed.all()
            draft.changed[...] = changed
        view = reader.newest()
        assert view is not None
        if changed.any():
            expected[changed] = view.content_revision
        np.testing.assert_array_equal(view.tile_revisions, expected)
        copy = reader.newest_copy(0)
        assert copy is not None
        assert copy.tile_revisions is not None
        np.testing.assert_array_equal(copy.tile_revisions, expected)


def test_a_frame_without_changed_tiles_confirms_the_one_before(make_ring: Callable[..., int]) -> None:
    fd = make_ring()
    writer, reader = FrameRingWriter(fd, "test", SHAPE), FrameRingReader(fd, "test", SHAPE)
    _write(writer, 1, revision=1, timestamp_ns=10)
    before = reader.newest()
    assert before is not None
    for step in range(3 * SHAPE.slot_count):
        with writer.write(2 + step, 100 + step) as draft:
            assert draft.previous is not None
            draft.pixels[...] = draft.previous
            draft.changed[...] = False
        after = reader.newest()
        assert after is not None
        assert after.confirmed_ns == 100 + step
        assert (after.sequence, after.content_revision, after.timestamp_ns) == (
            1,
            before.content_revision,
            10,
        )
        assert before.still_valid()
    _write(writer, 2, revision=100, timestamp_ns=200)
    after = reader.newest()
    assert after is not None
    assert (after.sequence, float(after.pixels[0, 0, 0])) == (2, 2.0)
    assert (after.tile_revisions != before.tile_revisions).all()


def test_the_picture_before_is_handed_to_the_next_writer_and_cannot_be_written(
    make_ring: Callable[..., int],
) -> None:
    fd = make_ring()
    with FrameRingWriter(fd, "test").write(1, 1) as draft:
        assert draft.previous is None
        draft.pixels[...] = 7
    with pytest.raises(KeyboardInterrupt):
        _die_while_writing(FrameRingWriter(fd, "test"))
    with FrameRingWriter(fd, "test").write(1, 2) as draft:
        assert draft.previous is not None
        assert (draft.previous == 7).all()
        with pytest.raises(ValueError, match="read-only"):
            draft.previous[0, 0, 0] = 3


def test_signal_wakes_once_for_any_number_of_notifications() -> None:
    fd = FrameSignal.create()
    try:
        frame_signal = FrameSignal(fd)
        assert not frame_signal.wait(0.0)
        for _ in range(3):
            frame_signal.notify()
        assert frame_signal.wait(5.0)
        assert not frame_signal.wait(0.0)
    finally:
        os.close(fd)


WRITER = """
import sys
from nearfield_server.capture.frame_ring import FrameRingWriter
writer = FrameRingWriter(int(sys.argv[1]), "stress")
n = 0
while True:
    n += 1
    if n == 2:
        print("ready", flush=True)
    with writer.write(n, n) as draft:
        value = (writer.newest_sequence + 1) % 2048
        for row in range(draft.pixels.shape[0]):
            draft.pixels[row] = value
        draft.counters[...] = n
"""


def test_writers_killed_at_random_moments_never_show_a_torn_frame(make_ring: Callable[..., int]) -> None:
    """Every pixel of a frame holds its sequence number, written row by row: a torn frame would hold two numbers."""
    fd = make_ring(RingShape(64, 64, 3))
    reader = FrameRingReader(fd, "stress")
    rng = random.Random(7)
    seen = set()
    last = 0
    for _ in range(6):
        process = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(fd)], pass_fds=[fd], stdout=subprocess.PIPE
        )
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == b"ready\n"
            stop = time.monotonic() + rng.uniform(0.02, 0.2)
            while time.monotonic() < stop:
                last = _check_newest(reader, last, seen)
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
            process.stdout.close()
        last = _check_newest(reader, last, seen)
        assert reader.newest() is not None  # a dead writer's last whole frame stays
    assert len(seen) > 6


def _check_newest(reader: FrameRingReader, last: int, seen: set[int]) -> int:
    view = reader.newest()
    if view is None:
        return last
    pixels = view.pixels.copy()
    if not view.still_valid():
        return last
    assert view.sequence >= last
    assert (pixels == view.sequence % 2048).all()
    seen.add(view.sequence)
    return view.sequence
