"""Doll's houses, cathedrals, and rooms a kilometre away from the origin of their coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from nearfield_protocol.codec import decode_light_packet
from nearfield_server.geometry.gather_table import build_gather_table
from nearfield_server.geometry.probes import ProbeRays
from nearfield_server.geometry.texels import rasterise_texels
from nearfield_server.illumination.packet import PacketWriter
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.radiometry.form_factor import val_irradiance
from nearfield_server.records import (
    CameraFrame,
    GatherTable,
    LightSettings,
    LightUpdate,
    ObjectPose,
    RoomMesh,
    TexelGeometry,
)
from nearfield_server.reference.box_room import lamp_field, make_box_room

SIZE = np.array([6.0, 3.0, 4.0])
FAR = np.array([1000.0, -400.0, 700.0])
LAMPS = ((3, (0.3, 0.4), (0.08, 0.12), (40.0, 38.0, 30.0)), (0, (0.5, 0.6), (0.1, 0.2), (10.0, 12.0, 15.0)))
PLACES = [(0.05, False), (0.05, True), (1.0, True), (50.0, False), (50.0, True)]


@dataclass(frozen=True, kw_only=True)
class Result:
    """Everything the server makes of one room."""

    mesh: RoomMesh
    texels: TexelGeometry
    table: GatherTable
    probe: np.ndarray
    pose: ObjectPose
    update: LightUpdate


@cache
def _run(scale: float, far: bool) -> Result:
    """The box room of `scale` x 6 m, through real rasterisation, visibility, probes and light stages."""
    shift = FAR if far else np.zeros(3)
    room = make_box_room(size=tuple(scale * SIZE), atlas_size=96, num_cameras=2, camera_size=96)
    mesh = room.mesh()
    mesh = replace(mesh, positions=mesh.positions + shift, content_hash="0123456789abcdef")
    cameras = []
    for camera in room.cameras:
        pose = camera.world_from_camera.copy()
        pose[:3, 3] += shift
        cameras.append(replace(camera, world_from_camera=pose))
    texels = rasterise_texels(mesh, 96, rasteriser="cpu")
    table = build_gather_table(mesh, texels, cameras)
    probes = ProbeRays(mesh, texels)
    centre = scale * np.array([2.03, 1.01, 1.57])
    world_from_object = np.eye(4)
    world_from_object[:3, 3] = centre + shift
    pose = ObjectPose(
        object_index=0,
        revision=1,
        world_from_object=world_from_object,
        centre_object=np.zeros(3),
        radius=0.01,
    )
    settings = LightSettings(split_ratio=0.45)
    pipeline = LightPipeline(mesh, texels, table, settings, probe_rays=probes, backend="cpu")
    field = lamp_field(room, LAMPS)
    frames = [
        CameraFrame(
            camera_index=i, sequence=1, content_revision=1, timestamp_ns=1, pixels=room.picture(i, field)
        )
        for i in range(2)
    ]
    return Result(
        mesh=mesh,
        texels=texels,
        table=table,
        probe=probes.trace(centre + shift, 32),
        pose=pose,
        update=pipeline.update(frames, [pose]),
    )


@pytest.mark.parametrize(("scale", "far"), PLACES)
def test_texels_keep_place_and_area(scale: float, far: bool) -> None:
    """Positions are exact up to float32: 0.03 mm at one kilometre."""
    base, found = _run(1.0, False).texels, _run(scale, far).texels
    np.testing.assert_array_equal(found.texel_index, base.texel_index)
    wanted = scale * base.position.astype(np.float64) + (FAR if far else 0.0)
    spacing = np.spacing(np.abs(wanted).max().astype(np.float32))
    assert np.abs(found.position - wanted).max() <= spacing
    assert spacing < 2e-4  # a cathedral that reaches beyond 1024 m; 0.06 mm below that
    np.testing.assert_allclose(found.area, scale**2 * base.area, rtol=1e-6)
    np.testing.assert_allclose(found.normal, base.normal, atol=1e-7)


@pytest.mark.parametrize(("scale", "far"), PLACES)
def test_cameras_and_probes_see_the_same_texels(scale: float, far: bool) -> None:
    """A room of 0.3 m at one kilometre lost a whole wall: its texels, rounded to 0.03 mm, lay behind themselves."""
    base, found = _run(1.0, False), _run(scale, far)
    assert (np.diff(found.table.pair_start) == np.diff(base.table.pair_start)).mean() > 0.998
    assert not (np.diff(found.table.pair_start) == 0).any()
    # Rays through edges between two texels or faces may fall to either side.
    assert (found.probe == base.probe).mean() > 0.98
    assert (found.probe >= 0).all()


@pytest.mark.parametrize(("scale", "far"), PLACES)
def test_light_scales_with_the_area(scale: float, far: bool) -> None:
    """Sum of I grows with the square of the room, indirect radiance not at all."""
    base, found = _run(1.0, False).update, _run(scale, far).update
    np.testing.assert_allclose(
        found.vals["radiant_intensity"].sum(axis=0, dtype=np.float64) / scale**2,
        base.vals["radiant_intensity"].sum(axis=0, dtype=np.float64),
        rtol=1e-3,
    )
    np.testing.assert_allclose(found.object_sh, base.object_sh, atol=2e-3 * np.abs(base.object_sh).max())


@pytest.mark.parametrize(("scale", "far"), [(1.0, False), *PLACES])
def test_packets_place_lights_within_half_a_step(scale: float, far: bool) -> None:
    """Half a step is 1 / 131070 of an edge (0.05 mm in a room of 6 m), and the rounding of float32 at that place."""
    found = _run(scale, far)
    update = found.update
    packet = decode_light_packet(PacketWriter.for_room(found.mesh, 0).write(update, [found.pose]))
    lit = update.vals["radiant_intensity"].any(axis=1)
    assert lit.sum() == 16
    error = np.abs(packet.vals["position"][lit].astype(np.float64) - update.vals["position"][lit])
    bound = packet.bounds_size / 131070.0 + np.spacing(np.abs(found.mesh.positions).max().astype(np.float32))
    assert (error <= bound).all()


@pytest.mark.parametrize("scale", [0.05, 1.0, 50.0])
def test_lights_stand_for_their_lamps_at_any_scale(scale: float) -> None:
    """Irradiance of 16 VALs against the sum over all direct texels, RMS over places and directions: lengths cancel."""
    room = make_box_room(size=tuple(scale * SIZE), atlas_size=128, num_cameras=2, camera_size=128)
    field = lamp_field(room, LAMPS)
    pipeline = LightPipeline(
        room.mesh(), room.texels, room.table, LightSettings(), probe_rays=room, backend="cpu"
    )
    frames = [
        CameraFrame(
            camera_index=i, sequence=1, content_revision=1, timestamp_ns=1, pixels=room.picture(i, field)
        )
        for i in range(2)
    ]
    update = pipeline.update(frames, [])
    direct = np.where(pipeline.texel_radiance >= update.threshold, pipeline.texel_radiance, 0.0)
    lamp = np.flatnonzero(direct.any(axis=1))
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    error = []
    for point in room.size * np.random.default_rng(1).uniform(0.2, 0.8, (20, 3)):
        offset = room.texels.position[lamp] - point
        squared = np.einsum("ni,ni->n", offset, offset)
        emitted = np.maximum(-(offset * room.texels.normal[lamp]).sum(axis=1), 0.0) / squared**2
        weights = np.maximum(normals @ offset.T, 0.0) * emitted * room.texels.area[lamp]
        exact = weights @ direct[lamp]
        found = sum(
            val_irradiance(
                np.broadcast_to(point, normals.shape),
                normals,
                val["position"],
                val["normal"],
                val["radiant_intensity"],
                float(val["area"]),
            )
            for val in update.vals
        )
        error.append(np.sqrt(np.mean((found - exact) ** 2)) / exact.mean())
    assert np.mean(error) < 0.04
