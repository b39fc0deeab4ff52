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
from nearfield_server.illumination.process import usable_fill
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
_FRAME_INTERVAL_NS = 33_333_333


@dataclass(frozen=True, slots=True, kw_only=True)
class LightRun:
    """What the server would send, and what it cost.

    Attributes:
        packet: decoded from `packet_bytes`, as a client has it.
        packet_bytes: compact encoding.
        update: the last result of the pipeline.
        texel_radiance: (N, 3) float32 gathered radiance.
        stage_ms: median wall time per stage over several full updates; `update` is a whole one, `skipped_update` one
            where nothing had changed, `first_update` the very first, compilation included.
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
    frames: Sequence[CameraFrame],
    objects: Sequence[PlacedObject],
    settings: LightSettings,
    clean_counts: dict[str, int],
) -> LightRun:
    """Several whole updates (each stage runs), one unchanged update, and the packet as a client decodes it.

    Args:
        mesh: room.
        texels: its texels.
        table: gather table of the cameras.
        fill: stand-ins for texels that no camera sees.
        frames: one per camera.
        objects: in packet order.
        settings: of the light extraction.
        clean_counts: from `camera_frames`, handed through.
    """
    pipeline = LightPipeline(
        mesh, texels, table, settings, probe_rays=ProbeRays(mesh, texels), unseen_fill=usable_fill(fill)
    )
    walls: list[float] = []
    stages: list[tuple[StageReport, ...]] = []
    for number in range(TIMED_UPDATES + 1):
        started = time.perf_counter()
        update = pipeline.update(
            [_renumbered(frame, number + 1) for frame in frames], _poses(objects, number)
        )
        walls.append(1000.0 * (time.perf_counter() - started))
        stages.append(update.stages)
    started = time.perf_counter()
    pipeline.update(
        [_renumbered(frame, TIMED_UPDATES + 1) for frame in frames], _poses(objects, TIMED_UPDATES)
    )
    skipped = 1000.0 * (time.perf_counter() - started)
    names = [stage.name for stage in stages[-1]]
    stage_ms = {
        name: float(
            np.median(
                [s.wall_ms for reports in stages[1:] for s in reports if s.name == name and s.ran] or [0.0]
            )
        )
        for name in names
    }
    stage_ms |= {"update": float(np.median(walls[1:])), "skipped_update": skipped, "first_update": walls[0]}
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
