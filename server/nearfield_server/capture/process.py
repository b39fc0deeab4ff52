"""The capture process: one camera, one ring. Started by the supervisor as `python -m nearfield_server.capture.process`."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.bus.backoff import Backoff
from nearfield_server.bus.keys import preview_key
from nearfield_server.bus.worker import Worker, run_worker
from nearfield_server.capture.cameras import image_circle, make_source
from nearfield_server.capture.frame_metadata import metadata_json
from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.frame_signal import FrameSignal
from nearfield_server.capture.ingest import compile_kernels, ingest_frame
from nearfield_server.capture.preview import PreviewPainter
from nearfield_server.capture.ring_memory import COUNTER_NAMES, RingShape
from nearfield_server.capture.source import RawFrame, Source
from nearfield_server.errors import AssetError, AwayError, CaptureError
from nearfield_server.scene.room_config import load_room

_RATE_WINDOW_S = 2.0
_FIRST_RETRY_S = 0.3
_LONGEST_RETRY_S = 1.0  # an attempt costs little; a camera that is back should be seen at once
_AWAY_RETRY_S = 0.7
_HEALTHY_AFTER_S = 10.0
_LATENCY_WEIGHT = 0.1


@dataclass(slots=True)
class CaptureStatistics:
    """Numbers for the status page."""

    frames: int = 0
    frame_rate: float = 0.0
    counters: Counter[str] = field(default_factory=Counter)
    frames_unchanged: int = 0
    tiles: int = 0
    tiles_changed: int = 0
    failures: int = 0
    latency_s: float | None = None
    """From the middle of the exposure to the ring, averaged over about ten frames."""
    _window_start_s: float = 0.0
    _window_frames: int = 0

    def count(self, now_s: float, counters: dict[str, int], tiles_changed: int) -> None:
        """Add one frame."""
        self.frames += 1
        self.frames_unchanged += tiles_changed == 0
        self.tiles_changed = tiles_changed
        self.counters.update({name: value for name, value in counters.items() if value})
        self._window_frames += 1
        self.roll(now_s)

    def note_latency(self, latency_s: float) -> None:
        """Add the latency of one new picture."""
        before = latency_s if self.latency_s is None else self.latency_s
        self.latency_s = before + _LATENCY_WEIGHT * (latency_s - before)

    def roll(self, now_s: float) -> None:
        """Renew the frame rate every two seconds, also when no frames come."""
        if now_s - self._window_start_s >= _RATE_WINDOW_S:
            self.frame_rate = self._window_frames / (now_s - self._window_start_s)
            self._window_start_s, self._window_frames = now_s, 0


class FramePump:
    """Moves frames from a source into a ring: ingest, write, wake the reader; an unchanged picture is only confirmed.

    Args:
        source: the camera.
        ring: where frames go.
        signal: rung after each new frame.
        circle: (H, W) bool, where the lens shows anything; None = everywhere.
        tolerance: change of a value relative to the one in use that is not passed on, see `tile_tolerance`.
    """

    def __init__(
        self,
        source: Source,
        ring: FrameRingWriter,
        signal: FrameSignal,
        circle: NDArray[np.bool_] | None,
        tolerance: float = 0.0,
    ) -> None:
        self.source, self.ring, self.signal = source, ring, signal
        self.circle, self.tolerance = circle, tolerance
        self.statistics = CaptureStatistics(tiles=math.prod(ring.shape.tile_grid))
        self._revision: int | None = None
        self._ring_revision = 0

    def reopened(self) -> None:
        """Forget the revision of the source: a reopened source may count from the beginning."""
        self._revision = None

    def step(self, now_ns: int) -> bool:
        """Take the frame of this period, if there is one; true if the source delivered.

        Raises:
            CaptureError, AssetError: from the source.
        """
        frame = self.source.next_frame(now_ns)
        now_s = now_ns * 1e-9
        if frame is None:
            self.statistics.roll(now_s)
            return False
        if frame.content_revision == self._revision:
            self.ring.confirm(frame.timestamp_ns)
            self.statistics.count(now_s, {}, 0)
            return True
        counters, tiles_changed = self._write(frame)
        self._revision = frame.content_revision
        self.statistics.note_latency((time.monotonic_ns() - frame.timestamp_ns) * 1e-9)
        if tiles_changed:
            self.signal.notify()
        self.statistics.count(now_s, counters, tiles_changed)
        return True

    def _write(self, frame: RawFrame) -> tuple[dict[str, int], int]:
        """Counters of the frame, and how many of its tiles differ from the frame before."""
        self._ring_revision += 1
        metadata = metadata_json(frame.metadata)
        with self.ring.write(self._ring_revision, frame.timestamp_ns, metadata) as draft:
            found = ingest_frame(
                frame.pixels,
                draft.pixels,
                self.circle,
                previous=draft.previous,
                changed=draft.changed,
                tolerance=self.tolerance,
            )
            counters = {**frame.counters, **found}
            draft.counters[...] = [counters.get(name, 0) for name in COUNTER_NAMES]
        return counters, int(np.count_nonzero(draft.changed))


def capture_loop(
    worker: Worker, pump: FramePump, frame_rate: float, describe: Callable[[], dict[str, Any]]
) -> None:
    """Run one camera until the worker is told to stop; a failing source is reopened with back-off for ever."""
    backoff = Backoff(initial_s=_FIRST_RETRY_S, maximum_s=_LONGEST_RETRY_S)
    is_open = False
    retry_at, healthy_since = 0.0, 0.0
    period_s = 1.0 / frame_rate
    fault, logged = "", ""
    missing_since_s: float | None = time.monotonic()
    while not worker.stop.is_set():
        try:
            if not is_open and time.monotonic() >= retry_at:
                # Reading basis pictures or finding a device may take longer than a frame.
                worker.beat("starting")
                pump.source.open()
                pump.reopened()
                is_open, healthy_since = True, time.monotonic()
            if is_open:
                state = worker.control
                if state is not None:
                    pump.source.set_light_weights(state.light_weights)
                delivered = pump.step(time.monotonic_ns())
                if delivered and missing_since_s is not None:
                    worker.log.info("camera delivers", after_s=round(time.monotonic() - missing_since_s, 2))
                    missing_since_s = None
                fault = "" if delivered else fault
                if time.monotonic() - healthy_since > _HEALTHY_AFTER_S:
                    backoff.reset()
                worker.beat(**_status(pump, describe, is_open, fault))
                pump.source.wait_for_frame(worker.stop, period_s)
        except (CaptureError, AssetError) as error:
            fault, is_open = str(error), False
            missing_since_s = missing_since_s or time.monotonic()
            pump.source.close()
            pump.statistics.failures += 1
            delay_s = backoff.next_delay()
            if isinstance(error, AwayError):
                delay_s = min(delay_s, _AWAY_RETRY_S)
            retry_at = time.monotonic() + delay_s
            if not isinstance(error, AwayError) or fault != logged:
                worker.log.warning("camera failed", reason=fault, retry_in_s=round(delay_s, 1))
            logged = fault
        if not is_open:
            worker.beat(**_status(pump, describe, is_open, fault))
            worker.stop.wait(min(period_s, 0.1))
    pump.source.close()


def _status(
    pump: FramePump, describe: Callable[[], dict[str, Any]], is_open: bool, fault: str
) -> dict[str, Any]:
    statistics = pump.statistics
    return {
        **describe(),
        "connected": is_open,
        "fault": fault,
        "frames": statistics.frames,
        "frame_rate": round(statistics.frame_rate, 2),
        "generation": pump.ring.generation,
        "counters": dict(statistics.counters),
        "frames_unchanged": statistics.frames_unchanged,
        "tiles": statistics.tiles,
        "tiles_changed": statistics.tiles_changed,
        "change_tolerance": pump.tolerance,
        "failures": statistics.failures,
        "latency_ms": None if statistics.latency_s is None else round(1e3 * statistics.latency_s, 2),
    }


def main(worker: Worker) -> None:
    """Open the ring and the camera that the specification names, and run."""
    camera_index = int(worker.spec.options["camera_index"])
    room = load_room(worker.spec.room_path)
    camera = room.cameras[camera_index]
    shape = RingShape(camera.intrinsics.height, camera.intrinsics.width)

    def origin_ns() -> int | None:
        """When recorded cameras begin together: as soon as the whole service runs."""
        state = worker.control
        return state.started_ns or None if state is not None else None

    replay = {**(worker.spec.options.get("replay") or {}), "origin_ns": origin_ns}
    circle = image_circle(camera.intrinsics)
    source = make_source(room, camera_index, {**worker.spec.options, "replay": replay}, circle)
    ring = FrameRingWriter(worker.spec.ring_fds[camera_index], camera.camera_id, shape)
    tolerance = room.change_tolerances[camera_index]
    pump = FramePump(source, ring, FrameSignal(worker.spec.signal_fd), circle, tolerance)
    readable = FrameRingReader(worker.spec.ring_fds[camera_index], camera.camera_id, shape)
    worker.bus.answer_question(preview_key(worker.spec.process), PreviewPainter(readable, circle).answer)
    compile_kernels()
    worker.wait_for_control(20.0)
    frame_rate = float(worker.spec.options.get("frame_rate") or room.frame_rate)

    def describe() -> dict[str, Any]:
        return {"camera_index": camera_index, "camera_id": camera.camera_id, "source": source.describe()}

    try:
        capture_loop(worker, pump, frame_rate, describe)
    finally:
        ring.close()


if __name__ == "__main__":
    run_worker(main)
