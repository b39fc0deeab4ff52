"""The illumination process: `python -m nearfield_server.illumination.process`, started by the supervisor.

Frames in, light packets out. It waits for the eventfd "frame ready" and for changes of the control state, never for a camera.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from nearfield_protocol.codec import encode_atlas_tiles
from nearfield_server.bus.keys import LIGHT_ATLAS, LIGHT_PACKET
from nearfield_server.bus.messages import ControlState, room_revision
from nearfield_server.bus.worker import Worker, run_worker
from nearfield_server.capture.frame_ring import FrameRingReader
from nearfield_server.capture.frame_signal import FrameSignal
from nearfield_server.capture.ring_memory import RingShape
from nearfield_server.geometry.cache import load_or_build
from nearfield_server.geometry.probes import ProbeRays
from nearfield_server.illumination.atlas_channel import AtlasChannel, build_downsampler
from nearfield_server.illumination.frames import STALE_AFTER_S, FrameCollector, FrameSource
from nearfield_server.illumination.light_journal import LightJournal
from nearfield_server.illumination.object_bounds import ObjectBounds, load_bounds, object_poses
from nearfield_server.illumination.packet import PacketStream, PacketWriter
from nearfield_server.illumination.work_ledger import WorkLedger
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.records import LightUpdate, RoomMesh, TexelGeometry
from nearfield_server.scene.room_config import RoomConfig, load_room

REPEAT_PERIOD_S = 1.0
ATLAS_PERIOD_S = 0.1
_WAIT_S = 0.1
_STRAGGLERS_S = 0.02
_STRAGGLERS_STEP_S = 0.002


class Illumination:
    """Frames to packets; one `step` per wake-up."""

    def __init__(
        self,
        worker: Worker,
        pipeline: LightPipeline,
        collector: FrameSource,
        writer: PacketWriter,
        atlas: AtlasChannel,
        bounds: list[ObjectBounds],
        ledger: WorkLedger,
        journal: LightJournal | None = None,
        make_pipeline: Callable[[], LightPipeline] | None = None,
    ) -> None:
        """Put the parts together.

        Args:
            worker: bus and life of the process.
            pipeline: in use from the start.
            collector: where frames come from.
            writer: numbers packets.
            atlas: of the streamed radiance.
            bounds: of every object.
            ledger: account of the stages.
            journal: tells a recorder what every update was made of.
            make_pipeline: makes one without a past, for the begin of a recording.
        """
        self._worker, self._pipeline, self._collector = worker, pipeline, collector
        self._packets, self._atlas, self._bounds, self._ledger = PacketStream(writer), atlas, bounds, ledger
        self._journal, self._make_pipeline = journal, make_pipeline
        self._published_s = 0.0
        self._packet = b""
        self._updates = 0
        self._last_run: LightUpdate | None = None
        self._atlas_s = 0.0
        self._atlas_wanted = False
        self._atlas_due = False
        worker.bus.answer(LIGHT_PACKET, lambda: self._packet)

    def step(self, state: ControlState, now_s: float) -> None:
        """Bring the light up to date and publish what changed.

        The newest packet is also repeated once per second: a gateway that has just started has heard none.
        """
        self._begin_journal_if_asked()
        poses = object_poses(state.objects, self._bounds)
        frames = self._collector.collect()
        if all(frame is None for frame in frames):
            return
        update = self._pipeline.update(frames, poses)
        if not self._collector.stayed_whole():
            update = self._pipeline.update(self._collector.recollect(), poses)
        ran = any(stage.ran for stage in update.stages)
        if ran:
            self._updates += 1
            self._last_run = update
        if ran or self._collector.had_news:
            self._ledger.add(update.stages, now_s)
        before = self._packet
        self._packet = self._packets.take(update, poses)
        if self._journal is not None:
            self._journal.note(frames, poses, self._packet)
        if self._packet != before or now_s - self._published_s >= REPEAT_PERIOD_S:
            self._put_packet(now_s)
        self._atlas_due |= any(stage.name == "gather" and stage.ran for stage in update.stages)
        self._step_atlas(state.atlas_wanted, update.timestamp_ns, now_s)

    def _begin_journal_if_asked(self) -> None:
        """Start without a past when a recording begins, so that everything afterwards follows from what it holds."""
        journal = self._journal
        if journal is None or self._make_pipeline is None:
            return
        run = journal.take_request()
        self._collector.always_copies = journal.is_on or run is not None
        if run is None:
            return
        self._pipeline = self._make_pipeline()
        self._packets = PacketStream(self._packets.writer.forgetful())
        journal.begin(run, self._packets.writer, self._pipeline.backend_name)

    def _put_packet(self, now_s: float) -> None:
        self._worker.bus.put(LIGHT_PACKET, self._packet)
        self._published_s = now_s

    def _step_atlas(self, wanted: bool, timestamp_ns: int, now_s: float) -> None:
        if wanted and not self._atlas_wanted:
            self._atlas.restart()
            self._atlas_due = True
        self._atlas_wanted = wanted
        if wanted and self._atlas_due and now_s - self._atlas_s >= ATLAS_PERIOD_S:
            self._atlas_s, self._atlas_due = now_s, False
            tiles = self._atlas.changes(self._pipeline.texel_radiance, timestamp_ns)
            if tiles is not None:
                self._worker.bus.put(LIGHT_ATLAS, encode_atlas_tiles(tiles), must_arrive=True)

    def status(self, camera_ids: list[str], stale_after_s: float) -> dict[str, Any]:
        """Return the fields of the status message."""
        now_ns = time.monotonic_ns()
        pictures = self._collector.pictures
        cameras = self._collector.report(camera_ids, now_ns, stale_after_s)
        ages = [camera["age_s"] for camera in cameras if camera["age_s"] is not None]
        status: dict[str, Any] = {
            "backend": self._pipeline.backend_name,
            "cameras": cameras,
            "light_age_s": max(ages, default=None),
            "stale": any(camera["stale"] for camera in cameras),
            "spread_ms": round(pictures.spread_ns * 1e-6, 3),
            "sequence": self._packets.writer.sequence,
            "revision": self._packets.revision,
            "updates": self._updates,
            "torn_frames": self._collector.torn,
            "atlas_wanted": self._atlas_wanted,
            **self._ledger.report(now_ns * 1e-9),
        }
        if self._last_run is not None:
            status["counters"] = self._last_run.counters
            status["threshold"] = [float(value) for value in self._last_run.threshold]
        return status


def prepare_pipeline(
    room: RoomConfig, options: dict[str, Any], progress: Callable[[str, float], None]
) -> tuple[Callable[[], LightPipeline], RoomMesh, TexelGeometry]:
    """Load the geometry of the room, and return what makes a pipeline without a past of it, as often as wanted.

    Args:
        room: the room.
        options: `num_vals`, `split_ratio`, `backend`, where they differ from the room file.
        progress: called with words and the share that is done.

    Raises:
        AssetError, ConfigError, GraphicsError: room model, settings or backend are unusable; the last two when a pipeline is made.
    """
    mesh, texels, table, fill, hidden = load_or_build(room, progress=progress)
    changes = {name: options[name] for name in ("num_vals", "split_ratio") if options.get(name) is not None}
    rays = ProbeRays(mesh, texels)

    def make() -> LightPipeline:
        return LightPipeline(
            mesh,
            texels,
            table,
            replace(room.light, **changes),
            probe_rays=rays,
            backend=options.get("backend") or "auto",
            unseen_fill=fill,
            hidden_light=hidden,
        )

    return make, mesh, texels


def prepare_illumination(
    worker: Worker, room: RoomConfig, collector: FrameSource, journal: LightJournal | None = None
) -> Illumination:
    """Prepare the room, with beats in between.

    Raises:
        AssetError, ConfigError, GraphicsError: room model, settings or backend are unusable.
    """
    make_pipeline, mesh, texels = prepare_pipeline(
        room,
        worker.spec.options,
        lambda text, part: worker.beat("starting", preparing=text, prepared=round(part, 3)),
    )
    return Illumination(
        worker,
        make_pipeline(),
        collector,
        # Milliseconds since boot: above everything that an earlier process of this room can have sent.
        PacketWriter.for_room(mesh, time.monotonic_ns() // 1_000_000),
        AtlasChannel(build_downsampler(texels), room_revision(mesh.content_hash)),
        load_bounds(room),
        WorkLedger(room.change_tolerances),
        journal,
        make_pipeline,
    )


def wait_for_all(collector: FrameCollector, signal: FrameSignal, period_s: float) -> None:
    """Wait a little for the cameras that are a moment later than the first: one update with all of them instead of two."""
    end_s = time.monotonic() + min(_STRAGGLERS_S, 0.5 * period_s)
    while not collector.is_complete(period_s) and time.monotonic() < end_s:
        # A camera that only confirms its picture rings no bell.
        signal.wait(_STRAGGLERS_STEP_S)


def main(worker: Worker) -> None:
    """Open the rings, prepare the room, and run until told to stop."""
    room = load_room(worker.spec.room_path)
    readers = [
        FrameRingReader(fd, camera.camera_id, RingShape(camera.intrinsics.height, camera.intrinsics.width))
        for fd, camera in zip(worker.spec.ring_fds, room.cameras, strict=True)
    ]
    period_s = 1.0 / (worker.spec.options.get("frame_rate") or room.frame_rate)
    collector = FrameCollector(readers, period_s)
    illumination = prepare_illumination(worker, room, collector, LightJournal(worker.bus))
    worker.wait_for_control(20.0)
    signal = FrameSignal(worker.spec.signal_fd)
    worker.on_control(signal.notify)
    camera_ids = [camera.camera_id for camera in room.cameras]
    # A camera asked for one frame in two seconds is not stale in between.
    stale_after_s = max(STALE_AFTER_S, 3.0 * period_s)
    worker.describe(lambda: illumination.status(camera_ids, stale_after_s))
    while not worker.stop.is_set():
        state = worker.control
        assert state is not None
        illumination.step(state, time.monotonic())
        worker.beat(preparing="")
        # A picture that waits for those of other cameras is used within a period, whether or not they come.
        if signal.wait(min(_WAIT_S, 0.25 * period_s) if collector.pictures.is_holding else _WAIT_S):
            wait_for_all(collector, signal, period_s)


if __name__ == "__main__":
    run_worker(main)
