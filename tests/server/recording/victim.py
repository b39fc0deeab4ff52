"""A recorder to be killed: rings, fast cameras, and a recording, all in one process. `zygote()` forks them ready to run."""

from __future__ import annotations

import os
import sys
import threading
import time
from pathlib import Path

import numpy as np

from nearfield_server.capture.fence import full_fence
from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.ring_memory import RingShape, create_ring
from nearfield_server.recording.backlog import Backlog
from nearfield_server.recording.files.json_lines import LineWriter
from nearfield_server.recording.files.light_log import LIGHT_FILE, LightBegin, LightStep, line_of
from nearfield_server.recording.files.packed_picture import pack_picture
from nearfield_server.recording.folder import begin_take, camera_entries
from nearfield_server.recording.process import make_writer
from nearfield_server.recording.recorder import Recorder
from nearfield_server.recording.snapshot import write_snapshot
from nearfield_server.recording.space import SpaceGuard
from nearfield_server.scene.room_config import ROOM_FILE, load_room

ROOM = Path(__file__).parents[2] / "data" / "tiny_room"
SIDE = 128


def pattern(camera: int, sequence: int, side: int = SIDE) -> np.ndarray:
    """(side, side, 4) float16 that tells camera and frame, all valid or lower bounds."""
    words = np.arange(side * side * 4, dtype=np.uint32) * np.uint32(2 * sequence + 1) + np.uint32(camera)
    pixels = (words % np.uint32(0x7BFF)).astype(np.uint16).reshape(side, side, 4)
    pixels[..., 3] = np.where(pixels[..., 0] % 7 == 0, 0x3BFF, 0x3C00)
    return pixels.view(np.float16)


def record(folder: Path, kind: str, seconds: float = 1e9, reserve_bytes: int | None = None) -> Recorder:
    """Record two cameras that deliver as fast as they can."""
    room = load_room(ROOM)
    folder.mkdir(exist_ok=True)
    if not (folder / ROOM_FILE).is_file():
        write_snapshot(folder, room, tuple(entry.camera_id for entry in camera_entries(room)))
    manifest, take = begin_take(folder, kind, room)  # type: ignore[arg-type]
    fds = [create_ring(f"cam{index}", RingShape(SIDE, SIDE)) for index in range(2)]
    writers = [FrameRingWriter(fd, "w") for fd in fds]
    recorder = Recorder(
        [FrameRingReader(fd, "r") for fd in fds],
        make_writer(folder, manifest, take.number),
        Backlog(64_000_000, 2),
        SpaceGuard(folder, reserve_bytes),
        take.number,
        2,
    )
    light = LineWriter(folder / LIGHT_FILE)
    begin = LightBegin(run=1, first_sequence=1, backend="cpu", room_revision=1)
    light.write(line_of(take.number, begin.to_fields()))
    stop = threading.Event()

    def capture() -> None:
        sequence = 0
        while not stop.is_set():
            sequence += 1
            for camera, writer in enumerate(writers):
                with writer.write(sequence, time.monotonic_ns()) as draft:
                    draft.pixels[...] = pattern(camera, sequence)
                    draft.counters[...] = 0
            time.sleep(0.002)

    camera = threading.Thread(target=capture, daemon=True)
    camera.start()
    number, end_s = 0, time.monotonic() + seconds
    while time.monotonic() < end_s and not recorder.fault:
        if recorder.poll():
            number += 1
            step = LightStep(
                run=1, number=number, frames=(number, None), objects=() if number == 1 else None, packet=b"p"
            )
            light.write(line_of(take.number, step.to_fields()))
        recorder.tend(time.monotonic())
        time.sleep(0.001)
    stop.set()
    camera.join()
    recorder.close()
    return recorder


def zygote() -> None:
    """Fork a recorder for each line `kind folder` on standard input, and print its process id; imports cost their time once."""
    full_fence()
    pack_picture(pattern(0, 1))
    for line in sys.stdin:
        kind, folder = line.split()
        pid = os.fork()
        if pid == 0:
            record(Path(folder), kind)
        sys.stdout.write(f"{pid}\n")
        sys.stdout.flush()
        os.waitpid(pid, 0)
        sys.stdout.write("gone\n")
        sys.stdout.flush()


if __name__ == "__main__":
    if sys.argv[1:2] == ["zygote"]:
        zygote()
    else:
        done = record(
            Path(sys.argv[1]), sys.argv[2], float(sys.argv[3]), int(sys.argv[4]) if sys.argv[4:] else None
        )
        sys.stdout.write(f"{done.frames_written}\n{done.fault}\n")
