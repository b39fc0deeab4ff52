"""Recorded cameras: the very bits, at the right time, in step with each other."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from structlog.testing import capture_logs
from tests.server.recording.conftest import HEIGHT, WIDTH, make_recording, picture

from nearfield_server.capture.frame_metadata import parse_metadata
from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.frame_signal import FrameSignal
from nearfield_server.capture.ingest import ingest_frame
from nearfield_server.capture.process import FramePump
from nearfield_server.capture.recording_source import RecordedCamera, RecordingSource
from nearfield_server.capture.ring_memory import RingShape, create_ring
from nearfield_server.errors import AssetError, CaptureError
from nearfield_server.recording.files.manifest import Kind

__all__ = ["make_recording"]
MS = 1_000_000
ORIGIN = 5 * 10**9


def _source(folder: Path, camera_id: str = "left", **changes: object) -> RecordingSource:
    fields: dict[str, object] = {
        "camera_id": camera_id,
        "folder": folder,
        "height": HEIGHT,
        "width": WIDTH,
        "origin_ns": lambda: ORIGIN,
    }
    source = RecordingSource(RecordedCamera(**{**fields, **changes}))  # type: ignore[arg-type]
    source.open()
    return source


def _shown(source: RecordingSource, ms: float) -> int | None:
    """Number of the recorded frame that is shown so long after the begin."""
    frame = source.next_frame(ORIGIN + round(ms * MS))
    return None if frame is None else int(frame.metadata["recorded_sequence"])


@pytest.mark.parametrize("kind", ["exr", "raw"])
def test_what_is_replayed_into_a_ring_is_what_was_in_the_ring(
    make_recording: Callable[..., Path], kind: Kind
) -> None:
    """Alpha included: valid, unknown, lower bound."""
    source = _source(make_recording(kind), "right.2")
    fd, bell = create_ring("cam", RingShape(HEIGHT, WIDTH)), FrameSignal.create()
    try:
        pump = FramePump(source, FrameRingWriter(fd, "w"), FrameSignal(bell), None)
        reader = FrameRingReader(fd, "r")
        for sequence in range(1, 5):
            assert pump.step(ORIGIN + (100 * (sequence - 1) + 1) * MS)
            view = reader.newest()
            assert view is not None
            recorded = picture(100 + sequence)
            frame = source.next_frame(ORIGIN + (100 * (sequence - 1) + 1) * MS)
            assert frame is not None
            np.testing.assert_array_equal(frame.pixels.view(np.uint16), recorded.view(np.uint16))
            in_ring = np.empty_like(recorded)
            ingest_frame(recorded, in_ring)
            np.testing.assert_array_equal(view.pixels.view(np.uint16), in_ring.view(np.uint16))
            metadata = parse_metadata(view.metadata)
            assert metadata["recorded_sequence"] == sequence
            assert metadata["exposures_s"] == [0.001, 0.1]
            assert view.counters["saturated"] == 3
    finally:
        os.close(fd)
        os.close(bell)


def test_frames_come_at_their_time_at_any_speed_over_and_over(make_recording: Callable[..., Path]) -> None:
    folder = make_recording("exr")
    source = _source(folder)
    assert [_shown(source, ms) for ms in (-50, 0, 99, 101, 399, 402, 505, 810)] == [1, 1, 1, 2, 4, 1, 2, 1]
    fast = _source(folder, speed=4.0)
    assert [_shown(fast, ms) for ms in (0, 24, 26, 99, 101)] == [1, 1, 2, 4, 1]
    once = _source(folder, loop=False)
    assert [_shown(once, ms) for ms in (0, 350, 402, 10_000)] == [1, 4, None, None]
    assert once.describe()["position_s"] == once.describe()["duration_s"]


def test_frames_of_one_moment_carry_one_time_in_all_cameras(make_recording: Callable[..., Path]) -> None:
    folder = make_recording("raw")
    stamps = []
    for camera_id, late_ms in (("left", 3), ("right.2", 77)):
        source = _source(folder, camera_id, speed=0.5)
        frames = [source.next_frame(ORIGIN + (200 * index + late_ms) * MS) for index in range(6)]
        stamps.append([frame.timestamp_ns - ORIGIN for frame in frames if frame])
    # Recorded a nanosecond apart.
    assert stamps[0] == [200 * index * MS + 2 * (index // 4) for index in range(6)]
    assert stamps[1] == [stamp + 2 for stamp in stamps[0]]


def test_the_first_picture_is_shown_until_all_cameras_begin(make_recording: Callable[..., Path]) -> None:
    origin: list[int | None] = [None]
    source = _source(make_recording("exr"), origin_ns=lambda: origin[0])
    revisions = []
    for ms in (0, 250, 900):
        frame = source.next_frame(ORIGIN + ms * MS)
        assert frame is not None
        revisions.append(frame.content_revision)
    assert revisions == [1, 1, 1]  # confirmed, not new
    origin[0] = ORIGIN + 1000 * MS
    assert [_shown(source, ms) for ms in (1050, 1150)] == [1, 2]
    lonely = _source(make_recording("exr", name="other"), origin_ns=lambda: None)
    assert [_shown(lonely, ms) for ms in (0, 119_000, 120_150)] == [1, 1, 2]


def test_it_waits_until_the_next_frame_is_due(make_recording: Callable[..., Path]) -> None:
    source = _source(make_recording("exr"), origin_ns=lambda: 0)
    stop = threading.Event()
    now_ns = time.monotonic_ns()
    assert source.next_frame(now_ns) is not None
    source.wait_for_frame(stop, 30.0)
    assert time.monotonic_ns() - now_ns >= 99 * MS
    frame = source.next_frame(time.monotonic_ns())
    assert frame is not None
    assert frame.metadata["recorded_sequence"] >= 2


def test_a_damaged_frame_is_dropped_counted_and_told_once(make_recording: Callable[..., Path]) -> None:
    folder = make_recording("exr")
    damaged = folder / "frames" / "left" / "0001_0000000002.exr"
    damaged.write_bytes(damaged.read_bytes()[:-30])
    source = _source(folder)
    with capture_logs() as logs:
        assert [_shown(source, ms) for ms in (0, 101, 201, 402, 505)] == [1, None, 3, 1, None]
    assert len(logs) == 1
    assert source.describe()["unreadable_files"] == 2


def test_what_does_not_fit_the_room_is_told_in_words(
    make_recording: Callable[..., Path], tmp_path: Path
) -> None:
    folder = make_recording("raw")
    with pytest.raises(CaptureError, match=r"there are: left, right\.2"):
        _source(folder, "middle")
    with pytest.raises(CaptureError, match="recorded with 10 x 6"):
        _source(folder, height=7)
    with pytest.raises(AssetError, match="no recording here"):
        _source(tmp_path / "none")
    for path in (folder / "segments").iterdir():
        path.write_bytes(b"")
    with pytest.raises(CaptureError, match="no frame"):
        _source(folder)
    with pytest.raises(CaptureError, match="before open"):
        RecordingSource(RecordedCamera(camera_id="a", folder=folder, height=1, width=1)).next_frame(1)
