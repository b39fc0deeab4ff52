"""Runs the real light pipeline on the camera pictures of a bundle, through ingest and the wire format."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.codec import LightPacket, decode_light_packet
from nearfield_server.capture.cameras import image_circle
from nearfield_server.capture.ingest import ingest_frame
from nearfield_server.errors import AssetError
from nearfield_server.evaluation.irradiance import PlacedObject
from nearfield_server.geometry.probes import ProbeRays
from nearfield_server.illumination.packet import PacketWriter
from nearfield_server.pipeline.hidden_light import HiddenLight
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.records import (
    CameraFrame,
    GatherTable,
    LightSettings,
    LightUpdate,
    ObjectPose,
    RoomMesh,
    StageReport,
    TexelGeometry,
    UnseenFill,
)
from nearfield_server.scene.bundle import Bundle, mix_basis
from nearfield_server.scene.exr import read_exr

TIMED_UPDATES = 5
SKIPPED_UPDATES = 25
_FRAME_INTERVAL_NS = 33_333_333


@dataclass(frozen=True, slots=True, kw_only=True)
class LightRun:
    """What the server would send, and what it cost.

    Attributes:
        packet: decoded from `packet_bytes`, as a client has it.
        packet_bytes: compact encoding.
        update: the last result of the pipeline.
        texel_radiance: (N, 3) float32 gathered radiance.
        stage_ms: median wall time per stage over several updates in which it ran; `update` is a change of all pictures, `moved_update`
            a moved object under unchanged light, `skipped_update` nothing new, `first_update` the very first, compilation included.
        backend: what the stages ran on.
        clean_counts: pixels that ingest had to correct, by kind.
    """

    packet: LightPacket
    packet_bytes: bytes
    update: LightUpdate
    texel_radiance: NDArray[np.float32]
    stage_ms: dict[str, float]
    backend: str
    clean_counts: dict[str, int]


def camera_frames(
    bundle: Bundle, weights: NDArray[np.float64]
) -> tuple[tuple[CameraFrame, ...], dict[str, int]]:
    """Pictures of all cameras under the given light weights, through ingest: half floats, clean.

    Returns:
        The frames, and the number of corrected pixels by kind.

    Raises:
        AssetError: a basis picture is missing, broken, or of another size than its camera.
    """
    factors = bundle.light_factors(weights)
    frames, totals = [], dict.fromkeys(("nan", "infinite", "negative", "above_range"), 0)
    for index, camera in enumerate(bundle.cameras):
        lens = camera.model.intrinsics
        pictures = [read_exr(path) for path in camera.files]
        for path, picture in zip(camera.files, pictures, strict=True):
            if picture.shape[:2] != (lens.height, lens.width):
                raise AssetError(
                    f"{path}: expected {lens.width} x {lens.height} pixels, found {picture.shape[1]} x {picture.shape[0]}."
                )
        mixed = mix_basis(pictures, factors).astype(np.float32)
        pixels = np.zeros((lens.height, lens.width, 4), np.float16)
        for kind, count in ingest_frame(mixed, pixels, image_circle(lens)).items():
            totals[kind] = totals.get(kind, 0) + count
        frames.append(
            CameraFrame(camera_index=index, sequence=0, content_revision=0, timestamp_ns=0, pixels=pixels)
        )
    return tuple(frames), totals


def run_light(
    mesh: RoomMesh,
    texels: TexelGeometry,
    table: GatherTable,
    fill: UnseenFill,
    hidden: HiddenLight | None,
    frames: Sequence[CameraFrame],
    objects: Sequence[PlacedObject],
    settings: LightSettings,
    clean_counts: dict[str, int],
) -> LightRun:
    """Time updates with new pictures, with moved objects and with nothing new, and give the packet as a client decodes it.

    Args:
        mesh: room.
        texels: its texels.
        table: gather table of the cameras.
        fill: stand-ins for texels that no camera sees.
        hidden: surfaces that no camera sees, which may be lamps.
        frames: one per camera.
        objects: in packet order.
        settings: of the light extraction.
        clean_counts: from `camera_frames`, handed through.
    """
    pipeline = LightPipeline(
        mesh,
        texels,
        table,
        settings,
        probe_rays=ProbeRays(mesh, texels),
        unseen_fill=fill,
        hidden_light=hidden,
    )
    still, walls = _poses(objects, 0), []
    stages: list[StageReport] = []
    first = 0.0
    for number in range(1, TIMED_UPDATES + 2):
        started = time.perf_counter()
        update = pipeline.update([_renumbered(frame, number) for frame in frames], still)
        walls.append(1000.0 * (time.perf_counter() - started))
        if number == 1:
            first = walls.pop()
        else:
            stages.extend(update.stages)
    newest = [_renumbered(frame, TIMED_UPDATES + 1) for frame in frames]
    moved, skipped = [], []
    for revision in range(1, TIMED_UPDATES + 1):
        started = time.perf_counter()
        update = pipeline.update(newest, _poses(objects, revision))
        moved.append(1000.0 * (time.perf_counter() - started))
        stages.extend(update.stages)
    for _ in range(SKIPPED_UPDATES):
        started = time.perf_counter()
        pipeline.update(newest, _poses(objects, TIMED_UPDATES))
        skipped.append(1000.0 * (time.perf_counter() - started))
    stage_ms = {
        name: float(
            np.median([stage.wall_ms for stage in stages if stage.name == name and stage.ran] or [0.0])
        )
        for name in dict.fromkeys(stage.name for stage in stages)
    }
    stage_ms |= {
        "update": float(np.median(walls)),
        "moved_update": float(np.median(moved)),
        "skipped_update": float(np.median(skipped)),
        "first_update": first,
    }
    data = PacketWriter.for_room(mesh, 0).write(update, _poses(objects, 0))
    return LightRun(
        packet=decode_light_packet(data),
        packet_bytes=data,
        update=update,
        texel_radiance=pipeline.texel_radiance.copy(),
        stage_ms=stage_ms,
        backend=pipeline.backend_name,
        clean_counts=clean_counts,
    )


def _renumbered(frame: CameraFrame, number: int) -> CameraFrame:
    """The same picture as a new one, so that no stage is skipped."""
    return CameraFrame(
        camera_index=frame.camera_index,
        sequence=number,
        content_revision=number,
        timestamp_ns=number * _FRAME_INTERVAL_NS,
        pixels=frame.pixels,
    )


def _poses(objects: Sequence[PlacedObject], revision: int) -> list[ObjectPose]:
    return [
        ObjectPose(
            object_index=index,
            revision=revision,
            world_from_object=item.world_from_object,
            centre_object=item.model.centre,
            radius=item.model.radius,
        )
        for index, item in enumerate(objects)
    ]
