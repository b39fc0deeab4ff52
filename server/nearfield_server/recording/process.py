"""The recorder process: `python -m nearfield_server.recording.process`, started by the supervisor on request.

It reads the same rings as the illumination. Neither capture nor light ever waits for it.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from nearfield_server.bus.keys import RECORDING_FINISH
from nearfield_server.bus.worker import Worker, run_worker
from nearfield_server.capture.frame_ring import FrameRingReader
from nearfield_server.capture.ring_memory import RingShape, available_memory
from nearfield_server.errors import ServiceError
from nearfield_server.recording.backlog import Backlog
from nearfield_server.recording.files.exr_store import ExrWriter
from nearfield_server.recording.files.json_lines import LineWriter
from nearfield_server.recording.files.light_log import LIGHT_FILE, line_of
from nearfield_server.recording.files.manifest import Manifest, TakeEntry, write_manifest
from nearfield_server.recording.files.raw_store import RawWriter
from nearfield_server.recording.folder import begin_take, camera_entries
from nearfield_server.recording.heap import keep_freed_memory
from nearfield_server.recording.light_link import LightLink
from nearfield_server.recording.recorder import SYNC_PERIOD_S, FrameWriter, Recorder
from nearfield_server.recording.snapshot import resolve_room, write_snapshot
from nearfield_server.recording.space import SpaceGuard
from nearfield_server.scene.room_config import ROOM_FILE, load_room

_POLL_S: Final = 0.01
_TEND_S: Final = 0.02
_STATUS_S: Final = 0.2
_PATIENCE_S: Final = 3.0
"""When the service ends: time for what waits to be written."""
_FINISH_PATIENCE_S: Final = 120.0
"""When only the recording ends."""
_QUEUE_BYTES: Final = 2_000_000_000
_QUEUE_SHARE: Final = 0.25
"""Most of the free memory that waiting frames may take."""


class LightLogFile:
    """Lines of the light log, from the bus to the disk."""

    def __init__(self, path: Path, take: int) -> None:
        self.updates = self.packets = 0
        self._lines, self._take = LineWriter(path), take
        self._synced_s = time.monotonic()

    def write(self, fields: dict[str, Any]) -> None:
        """Append a line.

        Raises:
            OSError: the disk refuses.
        """
        self.updates += fields.get("kind") == "update"
        self.packets += "packet" in fields
        self._lines.write(line_of(self._take, fields))
        now_s = time.monotonic()
        if now_s - self._synced_s > SYNC_PERIOD_S:
            self._synced_s = now_s
            self._lines.sync()

    def close(self) -> None:
        """Sync and close.

        Raises:
            OSError: the disk refuses.
        """
        try:
            self._lines.sync()
        finally:
            self._lines.close()


class RecordingRun:
    """One take: everything between begin and end."""

    def __init__(
        self, worker: Worker, manifest: Manifest, take: TakeEntry, recorder: Recorder, backlog: Backlog
    ) -> None:
        self._worker, self._manifest, self._take = worker, manifest, take
        self._recorder, self._backlog = recorder, backlog
        self._folder = Path(worker.spec.options["folder"])
        self._light = LightLogFile(self._folder / LIGHT_FILE, take.number)
        self._link = LightLink(worker.bus)
        self._link_is_open = True
        self._started_s = self._status_s = time.monotonic()
        self._state = "recording"
        self._stop_copying = threading.Event()
        self._lost_used = 0

    def run(self, finish: threading.Event) -> None:
        """Record until told to finish, or to stop with the service."""
        # Frames are copied in a thread of their own: nothing that touches the disk may hold it up.
        copier = threading.Thread(target=self._copy, name="copier", daemon=True)
        copier.start()
        stop = self._worker.stop
        while not (stop.is_set() or finish.is_set()):
            self._take_lines()
            self._tend()
            stop.wait(_TEND_S)
        self._stop_copying.set()
        copier.join()
        self._finish(_PATIENCE_S if stop.is_set() else _FINISH_PATIENCE_S)

    def _copy(self) -> None:
        beaten_s = 0.0
        while not self._stop_copying.wait(_POLL_S):
            self._recorder.poll()
            now_s = time.monotonic()
            if now_s - beaten_s > _STATUS_S:
                # The life of the process is that of this loop: a disk that hangs is no reason to end it.
                self._worker.beat()
                beaten_s = now_s

    def _take_lines(self) -> None:
        while True:
            try:
                fields = self._link.lines.get_nowait()
            except queue.Empty:
                return
            for camera, sequence in enumerate(fields.get("frames", ())):
                if sequence is not None:
                    self._backlog.mark_used(camera, sequence)
            if self._recorder.fault:
                continue
            try:
                self._light.write(fields)
            except OSError as error:
                self._recorder.stop_because(error)

    def _tend(self) -> None:
        now_s = time.monotonic()
        if now_s - self._status_s < _STATUS_S:
            return
        self._status_s = now_s
        self._recorder.tend(now_s)
        if self._backlog.dropped_used > self._lost_used and self._link.begin_again():
            self._lost_used = self._backlog.dropped_used
        if self._recorder.fault and self._state == "recording":
            self._state = "stopped"
            self._worker.log.warning("recording stopped", reason=self._recorder.fault)
        if self._state == "stopped" and self._link_is_open:
            self._link_is_open = False
            self._link.close()
        self._beat(now_s)

    def _beat(self, now_s: float) -> None:
        status = self._recorder.status(now_s)
        warnings = [self._recorder.fault] if self._recorder.fault else []
        if status["frames_dropped"]:
            warnings.append(
                f"{status['frames_dropped']} frames were not recorded: the disk or the processor is too slow"
            )
        self._worker.beat(
            fault=self._recorder.fault,
            state=self._state,
            folder=str(self._folder),
            kind=self._manifest.kind,
            take=self._take.number,
            elapsed_s=round(now_s - self._started_s, 2),
            light_updates=self._light.updates,
            light_packets=self._light.packets,
            warning="; ".join(warnings),
            **status,
        )

    def _finish(self, patience_s: float) -> None:
        self._state = "finishing"
        if self._link_is_open:
            self._link.close()
        self._recorder.poll()
        self._recorder.finish()
        end_s = time.monotonic() + patience_s
        while not self._recorder.is_drained and time.monotonic() < end_s:
            self._take_lines()
            self._beat(time.monotonic())
            time.sleep(0.05)
        self._take_lines()
        self._recorder.close()
        reason = self._recorder.fault or "ended as asked"
        try:
            if not self._recorder.fault:
                self._light.write({"kind": "end"})
            self._light.close()
            ended = replace(
                self._take,
                ended_ns=time.monotonic_ns(),
                reason=reason,
                frames_dropped=self._recorder.frames_dropped,
            )
            write_manifest(self._folder, self._manifest.with_take(ended))
        except OSError as error:
            self._worker.log.warning("end of the recording not noted", reason=str(error))
        self._state = "ended"
        # The last numbers are heard before the process is gone: the supervisor ends it when it has them.
        while not self._worker.stop.is_set():
            self._beat(time.monotonic())
            self._worker.stop.wait(_STATUS_S)


def make_writer(folder: Path, manifest: Manifest, take: int) -> FrameWriter:
    """The writer of a recording's format.

    Raises:
        OSError: the disk refuses.
    """
    if manifest.kind == "raw":
        return RawWriter(folder, manifest.cameras, take)
    return ExrWriter(folder, manifest.cameras)


def main(worker: Worker) -> None:
    """Prepare the folder, then record until told to stop."""
    keep_freed_memory()
    finish = threading.Event()
    worker.bus.subscribe(RECORDING_FINISH, lambda *_: finish.set())
    options = worker.spec.options
    folder = Path(options["folder"])
    room = load_room(worker.spec.room_path)
    room = resolve_room(room, options, worker.wait_for_control(20.0))
    try:
        # The room first: a folder that says it is a recording can be served.
        if not (folder / ROOM_FILE).is_file():
            write_snapshot(folder, room, tuple(entry.camera_id for entry in camera_entries(room)))
        manifest, take = begin_take(folder, options["kind"], room)
        writer = make_writer(folder, manifest, take.number)
        guard = SpaceGuard(folder, options.get("reserve_bytes"))
    except OSError as error:
        raise ServiceError(
            f"{folder}: a recording cannot be put there ({error.strerror or error})"
        ) from error
    readers = [
        FrameRingReader(fd, camera.camera_id, RingShape(camera.intrinsics.height, camera.intrinsics.width))
        for fd, camera in zip(worker.spec.ring_fds, room.cameras, strict=True)
    ]
    limit = min(_QUEUE_BYTES, int(_QUEUE_SHARE * available_memory()))
    backlog = Backlog(int(options.get("queue_bytes") or limit), len(readers))
    num_workers = min(len(readers), max(1, len(os.sched_getaffinity(0))))
    recorder = Recorder(readers, writer, backlog, guard, take.number, num_workers)
    RecordingRun(worker, manifest, take, recorder, backlog).run(finish)


if __name__ == "__main__":
    run_worker(main)
