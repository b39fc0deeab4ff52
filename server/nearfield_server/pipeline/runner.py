"""The runner: orders the light stages, skips what did not change, and reports what ran.

A stage has declared inputs; it runs when one of them changed: pictures and poses by their revision, everything after them bit for
bit, whether the radiance came from a whole gather or from one of changed tiles. Clocks are passed in.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.codec import VAL_DTYPE
from nearfield_server.errors import ConfigError, GraphicsError
from nearfield_server.pipeline.backend import BackendSetup, CpuBackend, StageBackend
from nearfield_server.pipeline.blocks import BLOCK
from nearfield_server.pipeline.clustering import ClusterState, empty_state, update_clusters
from nearfield_server.pipeline.frame_tracker import FrameTracker
from nearfield_server.pipeline.hidden_light import HiddenLight
from nearfield_server.pipeline.integration import ValSums
from nearfield_server.pipeline.probes import ProbeTracer
from nearfield_server.pipeline.stage_log import Clock, StageLog
from nearfield_server.records import (
    CameraFrame,
    GatherTable,
    LightSettings,
    LightUpdate,
    ObjectPose,
    RoomMesh,
    TexelGeometry,
    UnseenFill,
)

BackendName = Literal["auto", "cpu", "gl", "reference"]
LIGHT_STAGES: Final = ("split", "sample", "cluster", "integrate")
STAGES: Final = ("gather", *LIGHT_STAGES, "probe", "sh")
PROBE_RESOLUTION: Final = 64
"""Cube pixels per edge. Differs from the paper (32): the texels behind a probe are traced only when an object moves, and
64 point samples per edge lower the projection's error from 2.7 to 1.0 %."""
_MIN_VALS: Final = 1
_MAX_VALS: Final = 64


class LightPipeline:
    """Camera pictures in, virtual area lights and SH out. Use it from one thread."""

    def __init__(
        self,
        mesh: RoomMesh,
        texels: TexelGeometry,
        table: GatherTable,
        settings: LightSettings,
        *,
        probe_rays: ProbeTracer,
        backend: BackendName = "auto",
        unseen_fill: UnseenFill | None = None,
        hidden_light: HiddenLight | None = None,
        wall_clock: Clock = time.perf_counter,
        cpu_clock: Clock = time.process_time,
    ) -> None:
        """Prepare the static inputs.

        Args:
            mesh: the room.
            texels: its texels.
            table: which pixels show them.
            settings: how light is extracted.
            probe_rays: finds what a probe sees.
            backend: "cpu" (numba), "gl" (a real GPU), "reference" (float64, slow), or "auto": "gl" on a hardware
                renderer, else "cpu".
            unseen_fill: what texels that no camera sees repeat; they stay black where there is no source, or without it.
            hidden_light: surfaces that no camera sees any part of, which may be lamps (`hidden_light.find_hidden_light`,
                which takes seconds for a furnished room; `geometry.cache.load_or_build` keeps it). They stay black
                without it.
            wall_clock: seconds.
            cpu_clock: seconds of all threads of the process.

        Raises:
            ConfigError: settings or static inputs are unusable.
            GraphicsError: `backend="gl"` and there is no OpenGL context.
        """
        _check_inputs(texels, table, settings)
        fill_texels, fill_sources = _usable_fill(unseen_fill)
        setup = BackendSetup(
            mesh=mesh,
            texels=texels,
            table=table,
            settings=settings,
            fill_texels=fill_texels,
            fill_sources=fill_sources,
            hidden=hidden_light,
        )
        self._stages = _make_backend(backend, setup)
        self._settings = settings
        self._probe_rays = probe_rays
        self._log = StageLog(STAGES, wall_clock, cpu_clock)
        self._tracker = FrameTracker(table.camera_shapes)
        self._clusters: ClusterState = empty_state(settings.num_vals)
        self._points = np.zeros((0, 6))
        self._threshold = np.full(3, np.inf, dtype=np.float32)
        self._vals = np.zeros(settings.num_vals, dtype=VAL_DTYPE)
        self._is_half_done = True
        self._probe_revisions: list[tuple[int, int]] = []
        self._probes: list[NDArray[np.int32]] = []
        self._probe_blocks: list[NDArray[np.int64]] = []
        self._object_sh = np.zeros((0, 9, 3), dtype=np.float32)
        self._stale_objects: set[int] = set()
        self._unseen = int(np.count_nonzero(np.diff(table.pair_start) == 0)) - setup.fill_texels.size
        self._seen_frames: Sequence[CameraFrame | None] = ()
        self._seen_poses: Sequence[ObjectPose] = ()
        self._unchanged: LightUpdate | None = None
        self._revision = 0

    @property
    def backend_name(self) -> str:
        """What the stages run on: "cpu", "gl" or "reference"."""
        return self._stages.name

    @property
    def texel_radiance(self) -> NDArray[np.float32]:
        """(N, 3) newest gathered radiance in texel order; overwritten by the next update."""
        return self._stages.texel_radiance()

    def update(self, frames: Sequence[CameraFrame | None], poses: Sequence[ObjectPose]) -> LightUpdate:
        """Bring lights and SH up to date.

        Args:
            frames: newest picture per camera in the order of the room file, or None where there is nothing new: the last
                one stays in use. Its pixels must stay unchanged until the camera's next picture is passed in.
            poses: all objects, in the order of the room file.

        Returns:
            The result. Where no input changed, the call costs a comparison of revisions.

        Raises:
            ConfigError: the number, order or shape of the pictures does not fit the room.
        """
        unchanged = self._unchanged
        if unchanged is not None and self._is_seen(frames, poses):
            return unchanged
        self._unchanged = None
        self._tracker.take(frames)
        self._log.start()
        lights_changed = self._tracker.has_news() and self._refresh()
        changed = self._update_objects(poses)
        if lights_changed or changed or self._revision == 0:
            self._revision += 1
        update = self._result()
        self._log.start()
        self._unchanged = replace(update, stages=self._log.reports())
        self._seen_frames, self._seen_poses = tuple(frames), tuple(poses)
        return update

    def _is_seen(self, frames: Sequence[CameraFrame | None], poses: Sequence[ObjectPose]) -> bool:
        """Whether revisions and times are those of the last update; this is all that an unchanged update costs."""
        if len(frames) != len(self._seen_frames) or len(poses) != len(self._seen_poses):
            return False
        for frame, seen in zip(frames, self._seen_frames):  # noqa: B905 (equal lengths; strict costs time here)
            if frame is not seen and (
                frame is None
                or seen is None
                or frame.content_revision != seen.content_revision
                or frame.timestamp_ns != seen.timestamp_ns
            ):
                return False
        for pose, old in zip(poses, self._seen_poses):  # noqa: B905
            if pose is not old and (pose.revision != old.revision or pose.object_index != old.object_index):
                return False
        return True

    def _refresh(self) -> bool:
        """Pictures to lights. True if any light changed."""
        stages, log = self._stages, self._log
        tiles = self._tracker.changed_tiles()
        pixels = [None if frame is None else frame.pixels for frame in self._tracker.frames]
        # Should a stage fail, the next update starts over.
        self._tracker.forget()
        everything, self._is_half_done = self._is_half_done, True
        reason = "new pictures" if tiles is None else "changed tiles"
        gathered = log.timed("gather", reason, lambda: stages.gather(pixels, tiles), lambda done: done.part)
        lights_changed = False
        if everything or not gathered.is_same:
            self._mark_objects(None if everything else gathered.changed)
            lights_changed = self._extract("new radiance", everything)
        else:
            for stage in LIGHT_STAGES:
                log.skip(stage, "same radiance")
        self._is_half_done = False
        self._tracker.mark_gathered()
        return lights_changed

    def _extract(self, reason: str, everything: bool) -> bool:
        """Radiance to lights: the stages that depend on radiance alone. True if any light changed."""
        stages, log = self._stages, self._log
        threshold = log.timed("split", reason, stages.split)
        if not np.array_equal(threshold, self._threshold):
            self._stale_objects.update(range(len(self._probes)))
        self._threshold = threshold
        if not everything and not stages.direct_changed():
            for stage in LIGHT_STAGES[1:]:
                log.skip(stage, "same direct light")
            return False
        points = log.timed("sample", reason, stages.sample)
        if everything or not np.array_equal(points, self._points):
            iterations = self._settings.kmeans_iterations
            self._clusters = log.timed(
                "cluster", reason, lambda: update_clusters(self._clusters, points, iterations)
            )
            self._points = points
        else:
            log.skip("cluster", "same samples")
        clusters = self._clusters
        sums = log.timed("integrate", reason, lambda: stages.integrate(clusters.centres, clusters.alive))
        return self._pack_vals(sums)

    def _mark_objects(self, changed: NDArray[np.bool_] | None) -> None:
        """Note whose SH new radiance in some blocks, or anywhere, makes stale."""
        for k, blocks in enumerate(self._probe_blocks):
            if changed is None or changed[blocks].any():
                self._stale_objects.add(k)

    def _update_objects(self, poses: Sequence[ObjectPose]) -> bool:
        """Probes of moved objects, then SH of objects whose probe or light changed. True if any SH changed."""
        revisions = [(pose.object_index, pose.revision) for pose in poses]
        old = self._probe_revisions
        moved = [k for k, revision in enumerate(revisions) if k >= len(old) or old[k] != revision]
        if len(old) != len(revisions):
            self._probe_revisions, self._probes = old[: len(poses)], self._probes[: len(poses)]
            self._probe_blocks = self._probe_blocks[: len(poses)]
        if moved:
            self._probe_revisions = []
            self._log.timed(
                "probe",
                f"objects {moved} moved",
                lambda: self._trace(poses, moved),
                lambda _: len(moved) / len(poses),
            )
            self._probe_revisions = revisions
            self._stale_objects.update(moved)
        todo = sorted(k for k in self._stale_objects if k < len(poses))
        before = self._object_sh
        if not todo and before.shape[0] == len(poses):
            self._log.skip("sh", "same light around every object")
            return False
        reason = f"objects {moved} moved" if moved == todo else f"new light around objects {todo}"
        self._object_sh = self._log.timed(
            "sh",
            reason,
            lambda: self._project(before, len(poses), todo),
            lambda _: len(todo) / max(1, len(poses)),
        )
        self._stale_objects.clear()
        return not np.array_equal(before, self._object_sh)

    def _trace(self, poses: Sequence[ObjectPose], moved: Sequence[int]) -> None:
        self._probes = (self._probes + [np.zeros(0, dtype=np.int32)] * len(poses))[: len(poses)]
        self._probe_blocks = (self._probe_blocks + [np.zeros(0, dtype=np.int64)] * len(poses))[: len(poses)]
        for k in moved:
            world_from_object = poses[k].world_from_object
            centre = world_from_object[:3, :3] @ poses[k].centre_object + world_from_object[:3, 3]
            probe = self._probe_rays.trace(centre, PROBE_RESOLUTION)
            self._probes[k] = np.ascontiguousarray(probe, dtype=np.int32)
            self._probe_blocks[k] = np.unique(probe[probe >= 0] // BLOCK).astype(np.int64)

    def _project(self, before: NDArray[np.float32], count: int, todo: Sequence[int]) -> NDArray[np.float32]:
        object_sh = np.zeros((count, 9, 3), dtype=np.float32)
        object_sh[: min(count, before.shape[0])] = before[:count]
        for k in todo:
            object_sh[k] = self._stages.project_sh(self._probes[k], PROBE_RESOLUTION)
        return object_sh

    def _pack_vals(self, sums: ValSums) -> bool:
        """Lights as records for the wire; True if they differ from the last ones."""
        vals = np.zeros(self._settings.num_vals, dtype=VAL_DTYPE)
        vals["position"] = sums.position
        vals["normal"] = sums.normal
        vals["radiant_intensity"] = sums.radiant_intensity
        vals["area"] = sums.area
        vals["generation"] = self._clusters.generation
        changed = vals.tobytes() != self._vals.tobytes()
        self._vals = vals
        return changed

    def _result(self) -> LightUpdate:
        taken = [frame.timestamp_ns for frame in self._tracker.frames if frame is not None]
        intensity = self._vals["radiant_intensity"]
        counters = {
            "cameras_missing": float(len(self._tracker.frames) - len(taken)),
            "texels_unseen": float(self._unseen),
            "vals_used": float(np.count_nonzero(intensity.any(axis=1))),
            "direct_radiant_intensity": float(intensity.sum(dtype=np.float64) / 3.0),
        }
        return LightUpdate(
            revision=self._revision,
            timestamp_ns=min(taken, default=0),
            vals=self._vals,
            object_sh=self._object_sh,
            threshold=self._threshold,
            stages=self._log.reports(),
            counters=counters,
        )


def _check_inputs(texels: TexelGeometry, table: GatherTable, settings: LightSettings) -> None:
    if not _MIN_VALS <= settings.num_vals <= _MAX_VALS:
        raise ConfigError(f"num_vals: expected {_MIN_VALS} to {_MAX_VALS}, found {settings.num_vals}")
    if settings.split_ratio is not None and not 0.0 < settings.split_ratio <= 1.0:
        raise ConfigError(f"split_ratio: expected a share in (0, 1] or none, found {settings.split_ratio}")
    if settings.num_samples < settings.num_vals:
        raise ConfigError(
            f"num_samples: expected at least num_vals ({settings.num_vals}), found {settings.num_samples}"
        )
    if settings.kmeans_iterations < 1:
        raise ConfigError(f"kmeans_iterations: expected at least 1, found {settings.kmeans_iterations}")
    if table.pair_start.shape[0] != texels.area.shape[0] + 1:
        raise ConfigError(
            f"gather table is for {table.pair_start.shape[0] - 1} texels, the atlas has {texels.area.shape[0]}; rebuild it"
        )


def _usable_fill(fill: UnseenFill | None) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Texels that repeat another, and those others; texels without a source are left out."""
    if fill is None:
        return np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32)
    usable = fill.source >= 0
    return fill.texel[usable].astype(np.int32), fill.source[usable].astype(np.int32)


def _make_backend(name: BackendName, setup: BackendSetup) -> StageBackend:
    if name in ("auto", "gl"):
        try:
            # Found by name at run time: this package stays importable and testable without any graphics code.
            module = importlib.import_module("nearfield_server.gpu.light_stages")
            stages: StageBackend = module.create_light_backend(setup, allow_software=name == "gl")
        except (ImportError, GraphicsError) as error:
            if name == "gl":
                raise GraphicsError(
                    f'light backend "gl" is not usable: {error}; use "auto" or "cpu"'
                ) from error
        else:
            return stages
    elif name == "reference":
        from nearfield_server.reference.light_stages import ReferenceBackend

        return ReferenceBackend(setup)
    return CpuBackend(setup)
