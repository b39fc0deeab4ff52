"""What the illumination process sends, and what it leaves out because nothing needs it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nearfield_protocol.codec import VAL_DTYPE, decode_light_packet
from nearfield_server.bus.keys import LIGHT_ATLAS, LIGHT_PACKET
from nearfield_server.bus.messages import ControlState
from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.ring_memory import RingShape, create_ring
from nearfield_server.illumination.frames import FrameCollector
from nearfield_server.illumination.packet import PacketWriter
from nearfield_server.illumination.process import Illumination, ObjectBounds, wait_for_all
from nearfield_server.illumination.work_ledger import WorkLedger
from nearfield_server.records import CameraFrame, LightUpdate, ObjectPlacement, ObjectPose, StageReport


class FakeBus:
    """Remembers what was sent."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, bytes]] = []

    def put(self, key: str, payload: bytes, *, must_arrive: bool = False) -> None:
        self.sent.append((key, payload))

    def answer(self, key: str, reply: Any) -> None:
        assert key == LIGHT_PACKET
        self.newest = reply

    def take(self, key: str) -> list[bytes]:
        found = [payload for where, payload in self.sent if where == key]
        self.sent = [entry for entry in self.sent if entry[0] != key]
        return found


class FakePipeline:
    """One light whose radiant intensity is the first pixel of the first camera."""

    backend_name = "fake"

    def __init__(self) -> None:
        self._key: Any = None
        self._update = LightUpdate(
            revision=0,
            timestamp_ns=0,
            vals=np.zeros(8, VAL_DTYPE),
            object_sh=np.ones((1, 9, 3), np.float32),
            threshold=np.ones(3, np.float32),
            stages=(),
        )

    @property
    def texel_radiance(self) -> np.ndarray:
        return np.ones((4, 3), np.float32)

    def update(self, frames: list[CameraFrame | None], poses: list[ObjectPose]) -> LightUpdate:
        frame = frames[0]
        assert frame is not None
        key = (frame.content_revision, [pose.revision for pose in poses])
        ran = self._key is None or key[0] != self._key[0]
        report = StageReport(
            name="gather", ran=ran, reason="", wall_ms=1, cpu_ms=1, part=float(ran), saved_ms=1.0 - ran
        )
        if ran:
            vals = np.zeros(8, VAL_DTYPE)
            vals["normal"], vals["radiant_intensity"][0] = [0, 1, 0], frame.pixels[0, 0, :3]
            changed = vals.tobytes() != self._update.vals.tobytes()
            self._update = replace(
                self._update, revision=self._update.revision + changed, timestamp_ns=7, vals=vals
            )
        self._key = key
        return replace(self._update, stages=(report,))


class FakeAtlas:
    """Counts how often it was asked."""

    def __init__(self) -> None:
        self.asked = self.restarted = 0

    def restart(self) -> None:
        self.restarted += 1

    def changes(self, radiance: np.ndarray, timestamp_ns: int) -> None:
        self.asked += 1


class Bench:
    """An illumination process without neighbours."""

    def __init__(self, fd: int) -> None:
        self.camera = FrameRingWriter(fd, "w")
        self.bus, self.atlas, self.ledger = FakeBus(), FakeAtlas(), WorkLedger()
        worker: Any = type("Worker", (), {"bus": self.bus})()
        pipeline: Any = FakePipeline()
        atlas: Any = self.atlas
        low, size = np.zeros(3, np.float32), np.ones(3, np.float32)
        self.illumination = Illumination(
            worker,
            pipeline,
            FrameCollector([FrameRingReader(fd, "r")]),
            PacketWriter(bounds_min=low, bounds_size=size, room_revision=1, sequence=0),
            atlas,
            [ObjectBounds(np.zeros(3), 0.1)],
            self.ledger,
        )
        self.revision = 0

    def picture(self, value: float) -> None:
        self.revision += 1
        with self.camera.write(self.revision, self.revision) as draft:
            draft.pixels[...] = value
            draft.counters[...] = 0

    def step(self, now_s: float, *, pose: int = 1, atlas_wanted: bool = False) -> list[bytes]:
        placement = ObjectPlacement(revision=pose, world_from_object=np.eye(4))
        state = ControlState(revision=1, light_weights=(), objects=(placement,), atlas_wanted=atlas_wanted)
        self.illumination.step(state, now_s)
        return self.bus.take(LIGHT_PACKET)


@pytest.fixture
def bench() -> Iterator[Bench]:
    fd = create_ring("cam0", RingShape(4, 4, 3))
    yield Bench(fd)
    os.close(fd)


def test_a_packet_goes_out_when_the_light_changed_and_once_a_second(bench: Bench) -> None:
    assert bench.step(0.0) == []  # no picture yet
    bench.picture(1.0)
    [first] = bench.step(0.1)
    assert bench.bus.newest() == first
    assert [bench.step(0.1 + 0.1 * index) for index in range(1, 10)] == [[]] * 9
    assert bench.step(1.2) == [first]
    bench.picture(2.0)
    [second] = bench.step(1.3)
    assert decode_light_packet(second).sequence > decode_light_packet(first).sequence


def test_a_picture_that_changes_nothing_on_the_wire_makes_no_packet(bench: Bench) -> None:
    bench.picture(1.0)
    assert len(bench.step(0.1)) == 1
    bench.picture(1.001)  # radiant intensity travels with nine bits
    assert bench.step(0.2) == []
    assert len(bench.step(0.3, pose=2)) == 1


def test_the_atlas_is_made_for_subscribers_and_new_radiance_only(bench: Bench) -> None:
    bench.picture(1.0)
    bench.step(0.0)
    bench.picture(2.0)
    bench.step(0.2)
    assert bench.atlas.asked == 0
    for index in range(5):
        bench.step(0.4 + 0.2 * index, atlas_wanted=True)
    assert (bench.atlas.restarted, bench.atlas.asked) == (1, 1)
    bench.picture(3.0)
    bench.step(1.41, atlas_wanted=True)
    bench.picture(4.0)
    bench.step(1.45, atlas_wanted=True)  # too early: it waits for its period
    assert bench.atlas.asked == 2
    bench.step(1.6, atlas_wanted=True)
    bench.step(1.8, atlas_wanted=True)
    assert bench.atlas.asked == 3
    bench.step(2.0)
    bench.step(2.2, atlas_wanted=True)
    assert (bench.atlas.restarted, bench.atlas.asked) == (2, 4)
    assert bench.bus.take(LIGHT_ATLAS) == []


def test_only_updates_that_something_asked_for_are_counted(bench: Bench) -> None:
    bench.picture(1.0)
    for index in range(4):
        bench.step(0.1 * index)
    bench.camera.confirm(50)
    bench.step(0.5)
    bench.step(0.6)
    status = bench.illumination.status(["cam0"], 1.0)
    [gather] = status["stages"]
    assert (gather["updates_full"], gather["updates_skipped"]) == (1, 1)
    assert gather["ran"]
    assert status["skipping"].pop("age_s") > 0.0
    assert status["skipping"] == {
        "saved_ms": 0.0,
        "saved_total_ms": 1.0,
        "spent_total_ms": 2.0,
        "error_bound": 0.0,
    }


class Bell:
    """A signal that lets something happen at each wait."""

    def __init__(self, *events: Callable[[], object]) -> None:
        self.events, self.waits = list(events), 0

    def wait(self, timeout_s: float) -> bool:
        self.waits += 1
        if self.events:
            self.events.pop(0)()
        return False


def test_cameras_that_are_a_moment_later_are_waited_for_but_not_for_long() -> None:
    fds = [create_ring(f"cam{index}", RingShape(4, 4, 3)) for index in range(2)]
    writers = [FrameRingWriter(fd, "w") for fd in fds]
    collector = FrameCollector([FrameRingReader(fd, "r") for fd in fds])
    second = 1_000_000_000
    for writer in writers:
        writer.confirm(second)
    bell: Any = Bell()
    wait_for_all(collector, bell, 1.0)
    assert bell.waits == 0
    writers[0].confirm(2 * second)
    bell = Bell(int, lambda: writers[1].confirm(2 * second))
    wait_for_all(collector, bell, 1.0)
    assert bell.waits == 2
    writers[0].confirm(3 * second)
    bell = Bell()
    wait_for_all(collector, bell, 0.001)  # ends by the clock
    assert not collector.is_complete(1.0)
    for fd in fds:
        os.close(fd)
