"""The frame pump and the capture loop with a camera that does as it is told."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from nearfield_server.bus.backoff import Backoff
from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.frame_signal import FrameSignal
from nearfield_server.capture.process import FramePump, capture_loop
from nearfield_server.capture.ring_memory import RingShape, create_ring
from nearfield_server.capture.source import RawFrame, wait_for_period
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
        self._revision = 0  # a reopened source counts from the beginning

    def close(self) -> None:
        self.closed += 1

    def wait_for_frame(self, stop: threading.Event, period_s: float) -> None:
        wait_for_period(stop, period_s)

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
        self.log: Any = type(
            "Log", (), {level: lambda *_args, **_fields: None for level in ("info", "warning")}
        )()
        self.beats: list[dict[str, Any]] = []

    def beat(self, phase: str = "running", **status: Any) -> None:
        if phase == "running":
            self.beats.append(status)


def test_a_failing_camera_is_reopened_and_its_frames_are_never_mistaken_for_old_ones(
    fds: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Backoff, "next_delay", lambda self: 0.0)
    source = ScriptedSource([1.0, CaptureError("cable pulled"), 2.0, 2.0])
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
    view = reader.newest()
    assert view is not None
    assert (view.sequence, float(view.pixels[0, 0, 0])) == (2, 2.0)


def test_a_restarted_process_that_sees_the_same_picture_only_confirms_it(fds: tuple[int, int]) -> None:
    _pump(ScriptedSource([1.0]), fds)[0].step(10)
    pump, reader, signal = _pump(ScriptedSource([1.0, 3.0]), fds)
    signal.wait(0)
    before = reader.newest()
    assert before is not None
    assert pump.step(20)
    assert not signal.wait(0)
    assert reader.confirmed_ns == 20
    assert before.still_valid()
    assert (pump.statistics.frames, pump.statistics.frames_unchanged) == (1, 1)
    assert pump.step(30)
    after = reader.newest()
    assert after is not None
    assert (after.sequence, float(after.pixels[0, 0, 0])) == (2, 3.0)
    assert (after.tile_revisions > before.tile_revisions).all()


class EditedSource(ScriptedSource):
    """A picture in which random places get random values, the broken ones included."""

    def __init__(self, shape: RingShape, seed: int) -> None:
        super().__init__([])
        self._rng = np.random.default_rng(seed)
        self.pixels = self._rng.random((shape.height, shape.width, 4), np.float32)

    def next_frame(self, now_ns: int) -> RawFrame | None:
        self._revision += 1
        rng, (height, width, _) = self._rng, self.pixels.shape
        for _ in range(rng.integers(0, 4)):
            row, column = rng.integers(0, height), rng.integers(0, width)
            block = np.s_[row : row + rng.integers(1, 5), column : column + rng.integers(1, 5)]
            values = [
                0.0,
                -0.0,
                -1.0,
                0.25,
                0.75,
                1.0,
                np.nextafter(np.float32(1), np.float32(2)),
                1e5,
                np.nan,
                np.inf,
            ]
            self.pixels[(*block, rng.integers(0, 4))] = rng.choice(values)
        return RawFrame(pixels=self.pixels, timestamp_ns=now_ns, content_revision=self._revision)


def _clean(pixels: np.ndarray, circle: np.ndarray) -> np.ndarray:
    """What ingest is meant to do, in plain numpy."""
    known = circle & ~np.isnan(pixels[..., :3]).any(-1) & (pixels[..., 3] > 0.5)
    clean = np.zeros(pixels.shape, np.float16)
    clean[..., :3] = np.clip(np.nan_to_num(pixels[..., :3], nan=0.0, posinf=65504.0), 0.0, 65504.0) + 0.0
    clean[..., 3] = np.where(pixels[..., 3] < 1, np.nextafter(np.float16(1), np.float16(0)), np.float16(1))
    clean[~known] = 0.0
    return clean


def _die_while_writing(ring: FrameRingWriter) -> None:
    with ring.write(1 << 39, 1) as draft:
        draft.pixels[...] = 9.0
        raise KeyboardInterrupt


def test_equal_tile_revisions_mean_equal_pixels_over_thousands_of_edits() -> None:
    """Restarts, abandoned frames and readers that miss frames included; the picture itself is always the newest one."""
    shape = RingShape(75, 101, 3)
    fd, signal_fd = create_ring("cam0", shape), FrameSignal.create()
    rng = np.random.default_rng(5)
    circle = np.ones((75, 101), bool)
    circle[:20, :20] = False
    source, reader = EditedSource(shape, 6), FrameRingReader(fd, "r")
    pump = FramePump(source, FrameRingWriter(fd, "w"), FrameSignal(signal_fd), circle)
    taken: np.ndarray | None = None
    revisions = np.zeros(shape.tile_grid, np.int64)
    for step in range(3000):
        chance = rng.random()
        if chance < 0.01:
            pump = FramePump(source, FrameRingWriter(fd, "w"), FrameSignal(signal_fd), circle)
        elif chance < 0.02:
            with pytest.raises(KeyboardInterrupt):
                _die_while_writing(pump.ring)
        assert pump.step(step)
        if rng.random() < 0.4:
            continue  # the reader is busy
        view = reader.newest()
        assert view is not None
        pixels = view.pixels.copy()
        np.testing.assert_array_equal(pixels.view(np.uint16), _clean(source.pixels, circle).view(np.uint16))
        if taken is not None:
            differs = (pixels.view(np.uint16) != taken.view(np.uint16)).any(-1)
            changed = view.tile_revisions != revisions
            for row, column in np.argwhere(differs) // 32:
                assert changed[row, column]
            # And nothing is said to have changed that is as the newest frame before left it.
            if view.content_revision == revisions.max():
                assert not changed.any()
        taken, revisions = pixels, view.tile_revisions
    os.close(fd)
    os.close(signal_fd)
