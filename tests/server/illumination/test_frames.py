"""Frames straight from shared memory: newest, whole, and told apart from torn ones."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest

from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.ring_memory import RingShape, create_ring
from nearfield_server.illumination.frames import FrameCollector, camera_report

SHAPE = RingShape(4, 4, 3)


@pytest.fixture
def rings() -> Iterator[tuple[list[FrameRingWriter], list[FrameRingReader]]]:
    fds = [create_ring(f"cam{index}", SHAPE) for index in range(2)]
    yield [FrameRingWriter(fd, "w") for fd in fds], [FrameRingReader(fd, "r") for fd in fds]
    for fd in fds:
        os.close(fd)


def _write(writer: FrameRingWriter, value: float, timestamp_ns: int = 1) -> None:
    with writer.write(int(value), timestamp_ns) as draft:
        draft.pixels[...] = value
        draft.counters[...] = 0


def test_the_newest_frame_of_each_camera_and_none_where_there_is_none(
    rings: tuple[list[FrameRingWriter], list[FrameRingReader]],
) -> None:
    writers, readers = rings
    collector = FrameCollector(readers)
    assert collector.collect() == [None, None]
    assert collector.stayed_whole()
    _write(writers[1], 5)
    _write(writers[1], 6)
    first, second = collector.collect()
    assert first is None
    assert second is not None
    assert (second.camera_index, second.sequence) == (1, 2)
    assert (second.pixels == 6).all()
    assert collector.stayed_whole()


def test_an_overwritten_frame_is_noticed_and_taken_again_under_a_new_revision(
    rings: tuple[list[FrameRingWriter], list[FrameRingReader]],
) -> None:
    writers, readers = rings
    for writer in writers:
        _write(writer, 1)
    collector = FrameCollector(readers)
    seen = [frame.content_revision for frame in collector.collect() if frame]
    for value in range(2, 2 + SHAPE.slot_count):
        _write(writers[0], value)
    assert not collector.stayed_whole()
    assert collector.torn == 1
    again = [frame for frame in collector.recollect() if frame]
    assert collector.stayed_whole()
    assert not {frame.content_revision for frame in again} & set(seen)
    assert (again[0].pixels == 1 + SHAPE.slot_count).all()
    # For a while frames are copies: overwriting cannot hurt them.
    copies = [frame for frame in collector.collect() if frame]
    before = copies[0].pixels.copy()
    for value in range(10, 10 + SHAPE.slot_count):
        _write(writers[0], value)
    np.testing.assert_array_equal(copies[0].pixels, before)
    assert collector.stayed_whole()


def test_tiles_of_a_torn_picture_are_not_trusted_once(
    rings: tuple[list[FrameRingWriter], list[FrameRingReader]],
) -> None:
    """What was made of a torn picture is wrong even where the tiles did not change since."""
    writers, readers = rings
    for writer in writers:
        _write(writer, 1)
    collector = FrameCollector(readers)
    first = [frame for frame in collector.collect() if frame]
    assert all(frame.tile_revisions is not None for frame in first)
    for value in range(2, 2 + SHAPE.slot_count):
        _write(writers[0], value)
    assert not collector.stayed_whole()
    torn, other = collector.recollect()
    assert torn is not None
    assert torn.tile_revisions is None
    assert other is not None
    np.testing.assert_array_equal(other.tile_revisions, first[1].tile_revisions)
    assert all(frame is not None and frame.tile_revisions is not None for frame in collector.collect())


def test_distrust_waits_for_the_next_whole_picture(
    rings: tuple[list[FrameRingWriter], list[FrameRingReader]], monkeypatch: pytest.MonkeyPatch
) -> None:
    writers, readers = rings
    for writer in writers:
        _write(writer, 1)
    collector = FrameCollector(readers)
    collector.collect()
    for value in range(2, 2 + SHAPE.slot_count):
        _write(writers[0], value)
    assert not collector.stayed_whole()
    with monkeypatch.context() as patch:
        patch.setattr(FrameRingReader, "newest_copy", lambda self, index: None)
        assert collector.recollect() == [None, None]
    torn, other = collector.collect()
    assert torn is not None
    assert torn.tile_revisions is None
    assert other is not None
    assert other.tile_revisions is not None


def test_a_set_of_pictures_is_complete_when_all_live_cameras_spoke_in_one_period(
    rings: tuple[list[FrameRingWriter], list[FrameRingReader]],
) -> None:
    writers, readers = rings
    collector, ms = FrameCollector(readers), 1_000_000
    assert collector.is_complete(0.1)  # nobody has spoken: nothing to wait for
    _write(writers[0], 1, timestamp_ns=10_000 * ms)
    assert collector.is_complete(0.1)  # the other has never delivered
    _write(writers[1], 1, timestamp_ns=10_005 * ms)
    assert collector.is_complete(0.1)
    _write(writers[0], 2, timestamp_ns=10_100 * ms)
    assert not collector.is_complete(0.1)
    writers[1].confirm(10_101 * ms)
    assert collector.is_complete(0.1)
    for period in range(2, 9):  # camera 1 has died
        _write(writers[0], period, timestamp_ns=(10_000 + 100 * period) * ms)
        assert collector.is_complete(0.1) == (period > 5)


def test_age_counts_from_the_last_sign_of_the_camera(
    rings: tuple[list[FrameRingWriter], list[FrameRingReader]],
) -> None:
    writers, readers = rings
    second = 1_000_000_000
    _write(writers[0], 1, timestamp_ns=5 * second)
    report = camera_report(readers, ["left", "right"], 5 * second + second // 2)
    assert [entry["camera_id"] for entry in report] == ["left", "right"]
    assert [entry["age_s"] for entry in report] == [0.5, None]
    assert [entry["stale"] for entry in report] == [False, True]
    assert camera_report(readers, ["l", "r"], 7 * second)[0]["stale"]
    assert not camera_report(readers, ["l", "r"], 7 * second, stale_after_s=3.0)[0]["stale"]
    writers[0].confirm(7 * second)
    assert camera_report(readers, ["l", "r"], 7 * second)[0]["age_s"] == 0.0
