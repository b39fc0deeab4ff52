"""The frame pump and the capture loop with a camera that does as it is told."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from nearfield_server.bus.backoff import Backoff
from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter, RingShape, create_ring
from nearfield_server.capture.frame_signal import FrameSignal
from nearfield_server.capture.process import FramePump, capture_loop
from nearfield_server.capture.source import RawFrame
from nearfield_server.errors import CaptureError

SHAPE = RingShape(4, 6, 3)


class ScriptedSource:
    """Plays a list: a number is a frame of that value, None is no frame, an exception is raised."""

    def __init__(self, script: list[float | Exception | None]) -> None:
        self.script, self.opened, self.closed = script, 0, 0
        self.weights: list[tuple[float, ...]] = []
        self._revision = 0
        self._last: float | None = None
        self.exhausted = threading.Event()

    def open(self) -> None:
        self.opened += 1

    def close(self) -> None:
        self.closed += 1

    def set_light_weights(self, weights: tuple[float, ...]) -> None:
        self.weights.append(weights)

    def next_frame(self, now_ns: int) -> RawFrame | None:
        if not self.script:
            self.exhausted.set()
            return None
        step = self.script.pop(0)
        if isinstance(step, Exception):
            raise step
        if step is None:
            return None
        if step != self._last:
            self._last, self._revision = step, self._revision + 1
        pixels = np.full((4, 6, 3), step, np.float32)
        return RawFrame(
            pixels=pixels, timestamp_ns=now_ns, content_revision=self._revision, counters={"saturated": 2}
        )

    def describe(self) -> dict[str, str | int | float | bool]:
        return {"kind": "scripted"}


@pytest.fixture
def fds() -> Iterator[tuple[int, int]]:
    ring, signal = create_ring("cam0", SHAPE), FrameSignal.create()
    yield ring, signal
    os.close(ring)
    os.close(signal)


def _pump(source: ScriptedSource, fds: tuple[int, int]) -> tuple[FramePump, FrameRingReader, FrameSignal]:
    signal = FrameSignal(fds[1])
    return FramePump(source, FrameRingWriter(fds[0], "w"), signal, None), FrameRingReader(fds[0], "r"), signal


def test_new_pictures_are_written_and_old_ones_only_confirmed(fds: tuple[int, int]) -> None:
    pump, reader, signal = _pump(ScriptedSource([1.0, 1.0, np.nan, None]), fds)
    assert pump.step(10)
    assert signal.wait(0)
    first = reader.newest()
    assert first is not None
    assert (first.sequence, first.counters["saturated"]) == (1, 2)
    assert pump.step(20)
    assert not signal.wait(0)
    assert reader.confirmed_ns == 20
    assert first.still_valid()
    assert pump.step(30)
    assert signal.wait(0)
    third = reader.newest()
    assert third is not None
    assert (third.sequence, third.counters["nan"]) == (2, 24)
    assert third.content_revision != first.content_revision
    assert not pump.step(40)
    assert reader.confirmed_ns == 30
    assert pump.statistics.frames == 3
    assert pump.statistics.counters == {"saturated": 4, "nan": 24}


class FakeWorker:
    """The parts of `Worker` that the loop uses."""

    def __init__(self) -> None:
        self.stop = threading.Event()
        self.control = None
        self.log: Any = type("Log", (), {"warning": lambda *_args, **_fields: None})()
        self.beats: list[dict[str, Any]] = []

    def beat(self, phase: str = "running", **status: Any) -> None:
        if phase == "running":
            self.beats.append(status)


def test_a_failing_camera_is_reopened_and_its_frames_are_never_mistaken_for_old_ones(
    fds: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Backoff, "next_delay", lambda self: 0.0)
    source = ScriptedSource([1.0, CaptureError("cable pulled"), 1.0])
    pump, reader, _ = _pump(source, fds)
    worker = FakeWorker()
    loop = threading.Thread(target=capture_loop, args=(worker, pump, 500.0, source.describe))
    loop.start()
    assert source.exhausted.wait(30)
    worker.stop.set()
    loop.join()
    assert (source.opened, source.closed) == (2, 2)
    faults = [beat["fault"] for beat in worker.beats]
    assert "cable pulled" in faults
    assert faults[-1] == ""
    assert [beat["connected"] for beat in worker.beats[:3]] == [True, False, True]
    assert reader.newest().sequence == 2  # type: ignore[union-attr]
