"""Rings to disk: one thread copies frames out of the rings at once, others compress and write them at their own pace.

One more thread waits for the disk.
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Sequence
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.frame_metadata import parse_metadata
from nearfield_server.capture.frame_ring import FrameRingReader
from nearfield_server.recording.backlog import Backlog, WaitingFrame
from nearfield_server.recording.files.frame_info import FrameInfo
from nearfield_server.recording.space import SpaceGuard, WriteRate

SYNC_PERIOD_S: Final = 5.0
"""A power cut loses at most this much; a killed recorder loses only the frame in hand, because the kernel has the others."""
_NICE: Final = 5


class FrameWriter(Protocol):
    """Where frames go: `ExrWriter`, `RawWriter`. Every method raises OSError when the disk refuses."""

    def write(self, camera: int, info: FrameInfo, pixels: NDArray[np.float16]) -> int:
        """Write a frame and return its bytes; frames of one camera come from one thread and in order."""

    def sync(self) -> None:
        """Wait until the disk has everything written so far, while other threads write."""

    def close(self) -> None:
        """Sync and close."""


def describe_disk_fault(error: OSError) -> str:
    """What went wrong, in words for the status page."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return (
            "recording stopped: the disk is full; what was recorded is whole, free some space to record again"
        )
    return f"recording stopped: the disk refuses to write ({error.strerror or error}); what was recorded before is whole"


class Recorder:
    """Copies every new frame of every ring and has it written. `poll()` often; `close()` at the end.

    Args:
        readers: one ring per camera.
        writer: where frames go.
        backlog: where they wait.
        guard: says when the disk is nearly full.
        take: number of this recorder's life.
        num_workers: threads that compress and write; each has its own cameras, so that frames stay in order.
    """

    def __init__(
        self,
        readers: Sequence[FrameRingReader],
        writer: FrameWriter,
        backlog: Backlog,
        guard: SpaceGuard,
        take: int,
        num_workers: int,
    ) -> None:
        self.fault = ""
        """Why nothing is recorded any more, in words; the light goes on."""
        self.missed = 0
        """Frames that the rings had overwritten before they were copied."""
        self._readers, self._writer, self._backlog, self._guard = readers, writer, backlog, guard
        self._take = take
        # The newest picture at the start belongs to the recording: it is what the light is made of until the next one.
        self._next = [max(1, reader.newest_sequence) for reader in readers]
        self._lock = threading.Lock()
        self._written = [0] * len(readers)
        self._bytes = 0
        self._rate = WriteRate()
        self._ended = threading.Event()
        self._syncer = threading.Thread(target=self._sync_frames, name="syncer", daemon=True)
        self._workers = [
            threading.Thread(
                target=self._write_frames,
                args=(range(first, len(readers), num_workers),),
                name=f"writer{first}",
                daemon=True,
            )
            for first in range(min(num_workers, len(readers)))
        ]
        for worker in (*self._workers, self._syncer):
            worker.start()

    def poll(self) -> int:
        """Copy what is new and return how many frames that were; never waits for the disk."""
        copied = 0
        for camera, reader in enumerate(self._readers):
            newest = reader.newest_sequence
            first = self._next[camera]
            oldest_there = newest - reader.shape.slot_count + 1
            for sequence in range(first, min(oldest_there, newest + 1)):
                self._miss(camera, sequence)
            for sequence in range(max(first, oldest_there), newest + 1):
                copied += self._copy(camera, reader, sequence)
            self._next[camera] = max(first, newest + 1)
        return copied

    def _miss(self, camera: int, sequence: int) -> None:
        self.missed += 1
        self._backlog.lost(camera, sequence)

    def _copy(self, camera: int, reader: FrameRingReader, sequence: int) -> bool:
        view = reader.at(sequence)
        if view is None:
            self._miss(camera, sequence)
            return False
        pixels = self._backlog.buffer((reader.shape.height, reader.shape.width, 4))
        np.copyto(pixels, view.pixels)
        info = FrameInfo(
            take=self._take,
            sequence=sequence,
            content_revision=view.content_revision,
            timestamp_ns=view.timestamp_ns,
            counters={name: count for name, count in view.counters.items() if count},
            metadata=parse_metadata(view.metadata),
        )
        if not view.still_valid():
            self._backlog.done(pixels)
            self._miss(camera, sequence)
            return False
        if self.fault:
            self._backlog.done(pixels)
            return False
        return self._backlog.push(WaitingFrame(camera, info, pixels))

    def tend(self, now_s: float) -> None:
        """What is due now and then: stop before the disk is full."""
        if not self.fault and self._guard.is_low(now_s, self._rate_now(now_s)):
            free_mb = self._guard.free(now_s) / 1e6
            self._stop(
                f"recording stopped: only {free_mb:.0f} MB are free on the disk; what was recorded is whole"
            )

    def stop_because(self, error: OSError) -> None:
        """Record nothing more: some file beside the frames cannot be written."""
        self._stop(describe_disk_fault(error))

    def finish(self) -> None:
        """Copy nothing more; what waits is still written."""
        self._backlog.close()

    @property
    def is_drained(self) -> bool:
        """After `finish`: whether everything is written."""
        return not any(worker.is_alive() for worker in self._workers)

    def close(self) -> None:
        """Drop what still waits, and end."""
        self._backlog.close()
        self._backlog.clear()
        for worker in self._workers:
            worker.join()
        self._ended.set()
        self._syncer.join()
        try:
            self._writer.close()
        except OSError as error:
            self._stop(describe_disk_fault(error))

    @property
    def frames_dropped(self) -> int:
        """Frames that the disk was too slow for, and those that the rings had overwritten."""
        return sum(self._backlog.dropped) + self.missed

    @property
    def frames_written(self) -> int:
        """Frames on disk."""
        with self._lock:
            return sum(self._written)

    def status(self, now_s: float) -> dict[str, Any]:
        """Numbers for the status page."""
        with self._lock:
            written, num_bytes = list(self._written), self._bytes
            rate = self._rate.per_second(now_s)
        minutes = self._guard.minutes_left(now_s, rate)
        return {
            "frames_written": sum(written),
            "frames_written_by_camera": written,
            "frames_dropped": self.frames_dropped,
            "frames_dropped_in_rings": self.missed,
            "frames_dropped_that_light_used": self._backlog.dropped_used,
            "bytes_written": num_bytes,
            "megabytes_per_s": round(rate / 1e6, 2),
            "queue_frames": self._backlog.num_frames,
            "queue_mb": round(self._backlog.num_bytes / 1e6, 1),
            "queue_limit_mb": round(self._backlog.max_bytes / 1e6, 1),
            "free_mb": round(self._guard.free(now_s) / 1e6, 1),
            "minutes_left": None if minutes is None else round(minutes, 1),
        }

    def _rate_now(self, now_s: float) -> float:
        with self._lock:
            return self._rate.per_second(now_s)

    def _stop(self, reason: str) -> None:
        self.fault = self.fault or reason
        self._backlog.clear()

    def _write_frames(self, cameras: Sequence[int]) -> None:
        # Where processors are short, light and capture come first; frames can wait in the backlog.
        thread = threading.get_native_id()
        # Relative to what the service was started with (the kernel stops at 19): only root may ask for more than that.
        os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + _NICE)
        while True:
            frame = self._backlog.take(cameras, timeout_s=0.5)
            if frame is None:
                if self._backlog.is_closed:
                    return
                continue
            try:
                if not self.fault:
                    self._write(frame)
            except OSError as error:
                self._stop(describe_disk_fault(error))
            except Exception as error:  # a fault of ours must be seen, and must not end in silence
                self._stop(f"recording stopped: {type(error).__name__}: {error}")
                raise
            finally:
                self._backlog.done(frame.pixels)

    def _write(self, frame: WaitingFrame) -> None:
        size = self._writer.write(frame.camera, frame.info, frame.pixels)
        now_s = time.monotonic()
        self._guard.free(now_s, size)
        with self._lock:
            self._written[frame.camera] += 1
            self._bytes += size
            self._rate.add(now_s, size)

    def _sync_frames(self) -> None:
        # Apart from the writers: the disk may take seconds over what has gathered, and frames go on coming.
        while not self._ended.wait(SYNC_PERIOD_S):
            try:
                self._writer.sync()
            except OSError as error:
                self._stop(describe_disk_fault(error))
