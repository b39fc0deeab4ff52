"""Lockstep: every recorded frame is shown once per round, in order, whatever is damaged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from tests.server.recording.conftest import picture

from nearfield_server.recording.files.library import open_recording
from nearfield_server.recording.player import RecordedFrames


def test_every_frame_goes_by_in_step_with_the_other_camera(make_recording: Callable[..., Path]) -> None:
    frames = RecordedFrames(open_recording(make_recording("raw")))
    assert frames.collect() == [None, None]
    revisions: list[tuple[int, ...]] = []
    for _ in range(2):
        for sequence in range(1, 5):
            assert frames.advance()
            shown = [frame for frame in frames.collect() if frame]
            assert [frame.sequence for frame in shown] == [sequence, sequence]
            for camera, frame in enumerate(shown):
                np.testing.assert_array_equal(
                    frame.pixels.view(np.uint16), picture(100 * camera + sequence).view(np.uint16)
                )
            revisions.append(tuple(frame.content_revision for frame in shown))
        assert not frames.advance()
        assert frames.collect() == shown
        frames.rewind()
    assert len(frames) == 4
    # A revision never comes twice: the light must be made anew in the second round.
    assert len({revision for pair in revisions for revision in pair}) == 16
    assert all(entry["age_s"] == 0.0 and not entry["stale"] for entry in frames.report(["a", "b"], 0, 1.0))


def test_a_damaged_frame_is_counted_and_the_one_before_stays(make_recording: Callable[..., Path]) -> None:
    folder = make_recording("exr")
    (folder / "frames" / "left" / "0001_0000000003.exr").write_bytes(b"no picture")
    frames = RecordedFrames(open_recording(folder))
    shown = []
    while frames.advance():
        shown.append([None if frame is None else frame.sequence for frame in frames.collect()])
    assert shown == [[1, 1], [2, 2], [2, 3], [4, 4]]
    assert frames.unreadable == 1
