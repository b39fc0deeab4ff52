"""One bundle ready for the sweep: geometry, pictures clean and noisy, what each shows of the room, and the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.benchmark.methods.light import PROBE_RESOLUTION, AtlasSample, Surroundings
from nearfield_server.benchmark.methods.nearfield import Nearfield
from nearfield_server.benchmark.transfer_forms import PRESET
from nearfield_server.errors import AssetError
from nearfield_server.evaluation.evaluate import place_objects
from nearfield_server.evaluation.irradiance import PlacedObject
from nearfield_server.evaluation.light_run import camera_frames
from nearfield_server.evaluation.view_truth import ViewTruth, bundle_exposure, emitter_faces, load_view_truth
from nearfield_server.geometry.cache import load_or_build
from nearfield_server.geometry.probes import ProbeRays
from nearfield_server.pipeline.hidden_light import HiddenLight
from nearfield_server.pipeline.runner import BackendName, LightPipeline
from nearfield_server.records import (
    CameraFrame,
    GatherTable,
    LightSettings,
    ObjectPose,
    RoomMesh,
    TexelGeometry,
    UnseenFill,
)
from nearfield_server.scene.bundle import Bundle, load_bundle
from nearfield_server.scene.room_config import RoomConfig, room_from_bundle

NOISE: Final = 0.01
"""Relative deviation of every pixel of the camera pictures in the noisy sequence."""
_GATHER_RUNS: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodScene:
    """Everything that the methods of one bundle share.

    Attributes:
        bundle: with the truth. room, mesh, texels, table, fill, hidden: its geometry.
        objects: as prepared for Nearfield. poses: of them.
        around: static inputs of the baselines.
        probe_rays: of the room.
        clean: pictures without noise. noisy: a still room seen through noise.
        gather_cpu_ms: CPU time of gathering one set of pictures, which every method needs.
        views: what the tablet views should show, and their index in the bundle.
        exposure: display exposure of the bundle.
        backend: of the light pipeline.
    """

    bundle: Bundle
    room: RoomConfig
    mesh: RoomMesh
    texels: TexelGeometry
    table: GatherTable
    fill: UnseenFill
    hidden: HiddenLight | None
    objects: tuple[PlacedObject, ...]
    poses: tuple[ObjectPose, ...]
    around: Surroundings
    probe_rays: ProbeRays
    clean: AtlasSample
    noisy: tuple[AtlasSample, ...]
    gather_cpu_ms: float
    views: tuple[tuple[int, ViewTruth], ...]
    exposure: float
    backend: BackendName

    def make_nearfield(self, num_vals: int) -> Nearfield:
        """Nearfield's own pipeline, nothing seen yet."""
        return Nearfield(self._pipeline(num_vals), self.poses)

    def _pipeline(self, num_vals: int) -> LightPipeline:
        return _make_pipeline(
            self.mesh,
            self.texels,
            self.table,
            self.fill,
            self.hidden,
            self.probe_rays,
            num_vals,
            self.backend,
        )


def load_method_scene(
    path: Path, *, num_noisy: int, max_views: int, backend: BackendName, say: Callable[[str], None]
) -> MethodScene:
    """Read a bundle at nominal light and gather all its pictures.

    Args:
        path: of the bundle.
        num_noisy: pictures of the noisy sequence.
        max_views: tablet views with truth that are judged.
        backend: of the light pipeline.
        say: told what is being done.

    Raises:
        AssetError: the bundle is broken or holds no view with truth.
    """
    say("  geometry and camera pictures")
    bundle = load_bundle(path)
    with_truth = [view for view in bundle.views if view.small_with_object or view.with_object]
    if not bundle.objects or not with_truth:
        raise AssetError(
            f"{path}: methods are judged by views of virtual objects, and this bundle has {len(bundle.objects)} objects "
            f"and {len(with_truth)} views with them; leave it out"
        )
    weights = bundle.weights()
    room = room_from_bundle(bundle)
    mesh, texels, table, fill, hidden = load_or_build(room)
    objects = place_objects(bundle, PRESET)
    frames, _ = camera_frames(bundle, weights)
    probe_rays = ProbeRays(mesh, texels)
    pipeline = _make_pipeline(mesh, texels, table, fill, hidden, probe_rays, 16, backend)
    sequence = [frames, *(_noisy(frames, seed) for seed in range(num_noisy))]
    samples = [_gathered(pipeline, moment, number) for number, moment in enumerate(sequence)]
    emitter = emitter_faces(bundle, mesh)
    return MethodScene(
        bundle=bundle,
        room=room,
        mesh=mesh,
        texels=texels,
        table=table,
        fill=fill,
        hidden=hidden,
        objects=objects,
        poses=_poses(objects),
        around=_surroundings(mesh, texels, objects, probe_rays),
        probe_rays=probe_rays,
        clean=samples[0],
        noisy=tuple(samples[1:]),
        gather_cpu_ms=_gather_cpu_ms(pipeline, samples),
        views=tuple(
            (bundle.views.index(view), load_view_truth(bundle, view, weights, mesh, emitter))
            for view in with_truth[:max_views]
        ),
        exposure=bundle_exposure(bundle),
        backend=backend,
    )


def _make_pipeline(
    mesh: RoomMesh,
    texels: TexelGeometry,
    table: GatherTable,
    fill: UnseenFill,
    hidden: HiddenLight | None,
    probe_rays: ProbeRays,
    num_vals: int,
    backend: BackendName,
) -> LightPipeline:
    return LightPipeline(
        mesh,
        texels,
        table,
        LightSettings(num_vals=num_vals),
        probe_rays=probe_rays,
        backend=backend,
        unseen_fill=fill,
        hidden_light=hidden,
    )


def _gathered(pipeline: LightPipeline, frames: tuple[CameraFrame, ...], number: int) -> AtlasSample:
    pipeline.update([replace(frame, content_revision=number) for frame in frames], ())
    return AtlasSample(frames=frames, radiance=pipeline.texel_radiance.copy())


def _gather_cpu_ms(pipeline: LightPipeline, samples: list[AtlasSample]) -> float:
    """Median over a few updates, compiled by now."""
    times = []
    for number in range(_GATHER_RUNS):
        frames = samples[number % len(samples)].frames
        update = pipeline.update([replace(frame, content_revision=-1 - number) for frame in frames], ())
        times.append(next(stage.cpu_ms for stage in update.stages if stage.name == "gather"))
    return float(np.median(times))


def _noisy(frames: tuple[CameraFrame, ...], seed: int) -> tuple[CameraFrame, ...]:
    rng = np.random.default_rng(seed)
    result = []
    for frame in frames:
        pixels = frame.pixels.copy()
        gain = rng.normal(1.0, NOISE, (*pixels.shape[:2], 3)).astype(np.float32)
        pixels[..., :3] = np.clip(pixels[..., :3].astype(np.float32) * gain, 0.0, 65504.0)
        result.append(replace(frame, pixels=pixels))
    return tuple(result)


def _poses(objects: tuple[PlacedObject, ...]) -> tuple[ObjectPose, ...]:
    return tuple(
        ObjectPose(
            object_index=index,
            revision=0,
            world_from_object=item.world_from_object,
            centre_object=item.model.centre,
            radius=item.model.radius,
        )
        for index, item in enumerate(objects)
    )


def _surroundings(
    mesh: RoomMesh, texels: TexelGeometry, objects: tuple[PlacedObject, ...], probe_rays: ProbeRays
) -> Surroundings:
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    centre: NDArray[np.float64] = 0.5 * (low + high)
    centres = np.array([item.centre_world for item in objects]).reshape(-1, 3)
    return Surroundings(
        texels=texels,
        object_centres=centres,
        object_probes=tuple(probe_rays.trace(point, PROBE_RESOLUTION) for point in centres),
        room_centre=centre,
        room_probe=probe_rays.trace(centre, PROBE_RESOLUTION),
        room_diagonal=float(np.linalg.norm(high - low)),
    )
