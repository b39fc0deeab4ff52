"""The recorder: every frame, as fast as the disk allows; killed, throttled or on a full disk, it leaves a recording that replays."""

from __future__ import annotations

import errno
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.server.recording.victim import SIDE, pattern

from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.ring_memory import COUNTER_NAMES, RingShape, create_ring
from nearfield_server.recording.backlog import Backlog
from nearfield_server.recording.files.frame_info import FrameInfo
from nearfield_server.recording.files.library import open_recording
from nearfield_server.recording.recorder import Recorder
from nearfield_server.recording.space import DiskSpace, SpaceGuard
from nearfield_server.scene.room_config import load_room

VICTIM = Path(__file__).parent / "victim.py"
SHAPE = RingShape(4, 4, 4)


class MemoryWriter:
    """Keeps frames; `gate` holds writes up, `fault` refuses them."""

    def __init__(self) -> None:
        self.frames: list[tuple[int, FrameInfo, np.ndarray]] = []
        self.gate = threading.Event()
        self.gate.set()
        self.sync_gate = threading.Event()
        self.sync_gate.set()
        self.syncs = self.nice = 0
        self.fault: OSError | None = None
        self.sync_fault: OSError | None = None
        self.closed = False

    def write(self, camera: int, info: FrameInfo, pixels: np.ndarray) -> int:
        assert self.gate.wait(60)
        if self.fault:
            raise self.fault
        self.frames.append((camera, info, pixels.copy()))
        self.nice = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
        return pixels.nbytes

    def sync(self) -> None:
        self.syncs += 1
        assert self.sync_gate.wait(60)
        if self.sync_fault:
            raise self.sync_fault

    def close(self) -> None:
        self.closed = True


class Bench:
    """Two cameras and a recorder without processes."""

    def __init__(self, max_bytes: int = 10_000) -> None:
        self.fds = [create_ring(f"cam{index}", SHAPE) for index in range(2)]
        self.cameras = [FrameRingWriter(fd, "w") for fd in self.fds]
        self.writer = MemoryWriter()
        self.backlog = Backlog(max_bytes, 2)
        self.space = [10**9]
        self.recorder: Recorder | None = None

    def start(self) -> Recorder:
        guard = SpaceGuard(Path("/"), 1000, lambda _: DiskSpace(self.space[0], 10**9))
        readers = [FrameRingReader(fd, "r") for fd in self.fds]
        self.recorder = Recorder(readers, self.writer, self.backlog, guard, 1, 2)
        return self.recorder

    def picture(self, camera: int, value: float, metadata: bytes = b"") -> None:
        with self.cameras[camera].write(int(value), 1000 + int(value), metadata) as draft:
            draft.pixels[...] = value
            draft.counters[...] = [5 * (name == "saturated") for name in COUNTER_NAMES]

    def wait(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < end
            time.sleep(0.002)

    def values(self, camera: int) -> list[float]:
        return [float(pixels[0, 0, 0]) for c, _, pixels in self.writer.frames if c == camera]


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.writer.gate.set()
    bench.writer.sync_gate.set()
    if bench.recorder is not None:
        bench.recorder.close()
    for fd in bench.fds:
        os.close(fd)


def test_the_picture_at_the_start_and_every_one_after_it_are_written(bench: Bench) -> None:
    bench.picture(0, 1)
    bench.picture(0, 2)
    recorder = bench.start()
    assert recorder.poll() == 1
    for value in (3, 4, 5):
        bench.picture(0, value, b'{"gains":[2.0]}')
    bench.picture(1, 9)
    assert recorder.poll() == 4
    assert recorder.poll() == 0
    recorder.finish()
    bench.wait(lambda: recorder.is_drained)
    recorder.close()
    assert bench.values(0) == [2, 3, 4, 5]
    assert bench.values(1) == [9]
    _, found, _ = bench.writer.frames[-1] if bench.writer.frames[-1][0] == 0 else bench.writer.frames[-2]
    assert found.counters == {"saturated": 5}
    assert [entry.metadata for camera, entry, _ in bench.writer.frames if camera == 0][1:] == [
        {"gains": [2.0]}
    ] * 3
    assert (recorder.missed, recorder.frames_dropped) == (0, 0)
    assert bench.writer.closed


def test_writers_are_nicer_than_the_service_and_never_ask_for_more(bench: Bench) -> None:
    recorder = bench.start()
    bench.picture(0, 1)
    recorder.poll()
    bench.wait(lambda: recorder.frames_written == 1)
    assert bench.writer.nice == min(os.getpriority(os.PRIO_PROCESS, 0) + 5, 19)


def test_frames_that_the_ring_has_overwritten_are_counted(bench: Bench) -> None:
    recorder = bench.start()
    for value in range(1, 8):
        bench.picture(0, value)
    assert recorder.poll() == 4
    assert recorder.missed == 3
    bench.wait(lambda: bench.values(0) == [4, 5, 6, 7])


def test_a_slow_disk_costs_frames_that_are_counted_and_never_holds_up_the_copying(bench: Bench) -> None:
    bench.backlog.max_bytes = 3 * 128
    bench.writer.gate.clear()
    recorder = bench.start()
    for value in range(1, 11):
        bench.picture(0, value)
        recorder.poll()  # would hang here if it waited for the writer
    status = recorder.status(time.monotonic())
    # One is in the writer's hands at the most, three wait.
    assert status["frames_dropped"] in (6, 7)
    assert status["queue_frames"] == 3
    bench.writer.gate.set()
    bench.wait(lambda: recorder.frames_written == 10 - status["frames_dropped"])
    assert bench.values(0)[:3] == [1, 2, 3]


def test_frames_are_written_while_the_disk_is_waited_for(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nearfield_server.recording.recorder.SYNC_PERIOD_S", 0.01)
    bench.writer.sync_gate.clear()
    recorder = bench.start()
    bench.wait(lambda: bench.writer.syncs == 1)
    for value in range(1, 5):
        bench.picture(0, value)
        recorder.poll()
    bench.wait(lambda: recorder.frames_written == 4)
    assert bench.writer.syncs == 1
    bench.writer.sync_gate.set()
    bench.wait(lambda: bench.writer.syncs > 2)


def test_a_disk_that_fails_later_ends_the_recording_in_words(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nearfield_server.recording.recorder.SYNC_PERIOD_S", 0.01)
    bench.writer.sync_fault = OSError(errno.EIO, "Input/output error")
    recorder = bench.start()
    bench.wait(lambda: bool(recorder.fault))
    assert "refuses to write (Input/output error)" in recorder.fault


@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.ENOSPC, "the disk is full"), (errno.EIO, "refuses to write"), (errno.EDQUOT, "full")],
)
def test_a_disk_that_refuses_ends_the_recording_in_words(bench: Bench, number: int, words: str) -> None:
    recorder = bench.start()
    bench.picture(0, 1)
    recorder.poll()
    bench.wait(lambda: recorder.frames_written == 1)
    bench.writer.fault = OSError(number, os.strerror(number))
    bench.picture(0, 2)
    recorder.poll()
    bench.wait(lambda: bool(recorder.fault))
    assert words in recorder.fault
    bench.picture(0, 3)
    assert recorder.poll() == 0  # the rings are still read: nothing else changes
    assert bench.values(0) == [1]


def test_it_stops_before_the_disk_is_full(bench: Bench) -> None:
    recorder = bench.start()
    recorder.tend(1.0)
    assert not recorder.fault
    bench.space[0] = 999
    recorder.tend(2.0)
    assert "only 0 MB are free" in recorder.fault
    bench.picture(0, 1)
    assert recorder.poll() == 0


def _assert_replayable(folder: Path) -> int:
    """Every frame is what the camera showed; returns how many there are."""
    load_room(folder)
    recording = open_recording(folder)
    count = 0
    for camera, track in enumerate(recording.tracks):
        sequences = [frame.info.key for frame in track.frames]
        assert sequences == sorted(set(sequences))
        for frame in track.frames:
            np.testing.assert_array_equal(
                track.read(frame).view(np.uint16), pattern(camera, frame.info.sequence, SIDE).view(np.uint16)
            )
            count += 1
    runs = recording.light_runs([])
    assert all(step.number == number for run in runs for number, step in enumerate(run.updates, 1))
    return count


def test_killed_twenty_times_at_random_moments_it_leaves_a_recording_that_replays(tmp_path: Path) -> None:
    rng = random.Random(4)
    with subprocess.Popen(
        [sys.executable, str(VICTIM), "zygote"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as zygote:
        assert zygote.stdin is not None
        assert zygote.stdout is not None
        for kind in ("raw", "exr"):
            folder = tmp_path / kind
            counts = [0]
            for _ in range(10):
                zygote.stdin.write(f"{kind} {folder}\n")
                zygote.stdin.flush()
                pid = int(zygote.stdout.readline())
                time.sleep(rng.uniform(0.0, 0.2))
                os.kill(pid, signal.SIGKILL)
                assert zygote.stdout.readline() == "gone\n"
                if not (folder / "recording.json").exists():
                    continue  # killed before there was a recording
                counts.append(_assert_replayable(folder))
            # The takes before stay what they were, and new frames come.
            assert counts == sorted(counts)
            assert counts[-1] > 20
            assert len(open_recording(folder).manifest.takes) > 2
        zygote.stdin.close()


@pytest.mark.skipif(shutil.which("unshare") is None, reason="needs unshare of util-linux")
@pytest.mark.parametrize(("kind", "reserve"), [("raw", "0"), ("exr", "0"), ("raw", "3000000")])
def test_a_full_disk_ends_the_recording_and_what_was_written_is_whole(
    tmp_path: Path, kind: str, reserve: str
) -> None:
    """On a disk of 4 MB of its own, in a mount namespace; the copy is for those outside."""
    disk, copy = tmp_path / "disk", tmp_path / "copy"
    disk.mkdir()
    script = (
        f"mount -t tmpfs -o size=4m none {disk} && {sys.executable} {VICTIM} {disk}/r {kind} 60 {reserve} "
        f"&& df --output=avail -B1 {disk} | tail -1 && cp -r {disk}/r {copy}"
    )
    done = subprocess.run(
        ["unshare", "-Urm", "sh", "-c", script], capture_output=True, text=True, timeout=120, check=False
    )
    if "unshare failed" in done.stderr or "permission denied" in done.stderr:
        pytest.skip(f"no mount namespaces here: {done.stderr.strip()}")
    assert done.returncode == 0, done.stderr
    written, fault, free = done.stdout.splitlines()
    if reserve == "0":
        assert "the disk is full" in fault
    else:
        assert "MB are free" in fault
        assert int(free) > 2_000_000
    assert int(written) > 0
    assert _assert_replayable(copy) == int(written)
    assert not list(copy.rglob("*.tmp"))
