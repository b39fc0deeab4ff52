"""Packets on the bus carry what the pipeline found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nearfield_protocol.codec import VAL_DTYPE, decode_light_packet
from nearfield_server.bus.messages import ControlState, room_revision
from nearfield_server.illumination.object_bounds import object_bounds, object_poses
from nearfield_server.illumination.packet import PacketWriter
from nearfield_server.records import LightUpdate, ObjectPlacement, RoomMesh

HASH = "89abcdef" + "0" * 56


def _mesh() -> RoomMesh:
    positions = np.array([[0, 0, 0], [3, 0, 0], [0, 2, 4]], np.float64)
    return RoomMesh(
        positions=positions,
        normals=np.zeros((3, 3)),
        uv=np.zeros((3, 2)),
        faces=np.array([[0, 1, 2]], np.int32),
        face_material=np.zeros(1, np.int32),
        materials=("m",),
        material_albedo=np.ones((1, 3)),
        uv_source="file",
        content_hash=HASH,
    )


def _state(pose_revision: int) -> ControlState:
    placement = ObjectPlacement(revision=pose_revision, world_from_object=np.eye(4))
    return ControlState(revision=1, light_weights=(), objects=(placement,))


def test_a_packet_carries_lights_sh_and_revisions() -> None:
    vals = np.zeros(8, VAL_DTYPE)
    vals["position"] = [3.0, 2.0, 4.0]  # the far corner of the room
    vals["normal"] = [0, -1, 0]
    vals["radiant_intensity"][2] = [4.0, 2.0, 1.0]
    vals["area"] = 0.25
    sh = np.arange(27, dtype=np.float32).reshape(1, 9, 3)
    update = LightUpdate(
        revision=3, timestamp_ns=77, vals=vals, object_sh=sh, threshold=np.ones(3, np.float32), stages=()
    )
    state = _state(12)
    bounds = [object_bounds(np.array([[0.0, 0, 0], [2, 2, 2]]))]
    writer = PacketWriter.for_room(_mesh(), first_sequence=0xFFFFFFFE)
    packet = decode_light_packet(writer.write(update, object_poses(state.objects, bounds)))
    assert packet.sequence == 0xFFFFFFFF
    assert packet.timestamp_ns == 77
    assert packet.room_revision == room_revision(HASH) == 0x89ABCDEF
    assert packet.object_revisions.tolist() == [12]
    # One step of the compact position and of the shared exponents.
    np.testing.assert_allclose(packet.vals["position"][2], [3, 2, 4], atol=4.01 / 65535)
    np.testing.assert_allclose(packet.vals["radiant_intensity"][2], [4, 2, 1], atol=4 / 256)
    np.testing.assert_allclose(packet.object_sh, sh, rtol=2**-11)


def test_light_that_is_the_same_on_the_wire_is_the_same_packet() -> None:
    vals = np.zeros(8, VAL_DTYPE)
    vals["position"], vals["normal"], vals["area"] = [1.0, 1.0, 1.0], [0, 1, 0], 0.1
    vals["radiant_intensity"] = [4.0, 2.0, 1.0]
    update = LightUpdate(
        revision=1,
        timestamp_ns=5,
        vals=vals,
        object_sh=np.ones((1, 9, 3), np.float32),
        threshold=np.ones(3, np.float32),
        stages=(),
    )
    poses = object_poses(_state(12).objects, [object_bounds(np.zeros((1, 3)))])
    writer = PacketWriter.for_room(_mesh(), first_sequence=0xFFFFFFFE)
    first = writer.write(update, poses)
    moved = vals.copy()
    moved["radiant_intensity"] *= 1.0001  # far below half a step of nine bits
    assert writer.write(replace(update, revision=2, timestamp_ns=9, vals=moved), poses) is first
    moved["radiant_intensity"] *= 1.01
    second = writer.write(replace(update, revision=3, timestamp_ns=10, vals=moved), poses)
    assert decode_light_packet(second).sequence == 0
    assert decode_light_packet(second).timestamp_ns == 10
    # Clients wait for the revision of a pose, also where the light is the same.
    third = writer.write(update, object_poses(_state(13).objects, [object_bounds(np.zeros((1, 3)))]))
    assert decode_light_packet(third).object_revisions.tolist() == [13]


def test_the_bounding_sphere_holds_all_points() -> None:
    points = np.random.default_rng(0).normal(size=(200, 3))
    sphere = object_bounds(points)
    distances = np.linalg.norm(points - sphere.centre, axis=1)
    np.testing.assert_allclose(distances.max(), sphere.radius, rtol=1e-12)
    np.testing.assert_allclose(sphere.centre, (points.min(0) + points.max(0)) / 2)
