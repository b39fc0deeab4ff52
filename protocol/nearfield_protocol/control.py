"""The small messages: control state and status to the client; ack, subscribe, pose and weight from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from nearfield_protocol.errors import EncodeError
from nearfield_protocol.framing import HEADER_BYTES, Reader, check_limit, frame, require, write_record
from nearfield_protocol.layout import (
    ACK,
    CONTROL_STATE,
    MAX_CAMERAS,
    MAX_CLIENT_MESSAGE_BYTES,
    MAX_LIGHTS,
    MAX_OBJECTS,
    OBJECT_POSE,
    SET_LIGHT_WEIGHT,
    SET_OBJECT_POSE,
    STATUS,
    SUBSCRIBE,
    Encoding,
    MessageType,
)
from nearfield_protocol.light_records import MAX_COORDINATE

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

UNIT_TOLERANCE = 1e-3
"""How far the norm of a quaternion may be from 1."""
MAX_WEIGHT = 1e6
"""Largest light weight; anything above is a mistake."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WirePose:
    """Pose of one object: revision, position in metres (world), unit quaternion x, y, z, w (object to world axes)."""

    pose_revision: int
    position: Vector3
    quaternion: Quaternion


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlState:
    """What holds now: weight of every switchable light and pose of every object, in the order of the scene description."""

    sequence: int
    revision: int
    light_weights: tuple[float, ...]
    object_poses: tuple[WirePose, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """Heartbeat.

    Attributes:
        sequence: counts messages of this type.
        server_time_ns: now, the clock of `timestamp_ns`.
        light_age: seconds since the newest light was captured; infinite if there was none, NaN if not known.
        camera_ages: the same for every camera, in the order of the room file.
        is_stale: the light is too old to be trusted.
    """

    sequence: int
    server_time_ns: int
    light_age: float
    camera_ages: tuple[float, ...]
    is_stale: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Ack:
    """A client has taken a light packet or an atlas message."""

    sequence: int
    acknowledged_type: MessageType
    acknowledged_sequence: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Subscribe:
    """What a client wants to receive."""

    sequence: int
    encoding: Encoding
    wants_atlas: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class SetObjectPose:
    """Move the object with this index: position in metres (world), unit quaternion x, y, z, w (object to world axes)."""

    sequence: int
    object_index: int
    position: Vector3
    quaternion: Quaternion


@dataclass(frozen=True, slots=True, kw_only=True)
class SetLightWeight:
    """Dim the switchable light with this index to `weight` times its radiance."""

    sequence: int
    light_index: int
    weight: float


ClientMessage = Ack | Subscribe | SetObjectPose | SetLightWeight


def encode_control_state(state: ControlState) -> bytes:
    """Write a control state.

    Raises:
        EncodeError: Too many lights or objects, or a number that is not allowed.
    """
    if len(state.light_weights) > MAX_LIGHTS or len(state.object_poses) > MAX_OBJECTS:
        found = f"{len(state.light_weights)} and {len(state.object_poses)}"
        raise EncodeError(
            "control_state", expected=f"at most {MAX_LIGHTS} lights and {MAX_OBJECTS} objects", found=found
        )
    for i, weight in enumerate(state.light_weights):
        if not 0 <= weight <= MAX_WEIGHT:
            raise EncodeError(f"light_weights[{i}]", expected=f"0 to {MAX_WEIGHT:g}", found=weight)
    poses = []
    for i, pose in enumerate(state.object_poses):
        _check_pose(pose.position, pose.quaternion, f"object_poses[{i}]")
        poses.append(
            write_record(
                OBJECT_POSE,
                pose_revision=pose.pose_revision,
                position=pose.position,
                quaternion=pose.quaternion,
            )
        )
    head = write_record(
        CONTROL_STATE,
        revision=state.revision,
        num_lights=len(state.light_weights),
        num_objects=len(state.object_poses),
    )
    weights = np.asarray(state.light_weights, "<f4").tobytes()
    return frame(MessageType.CONTROL_STATE, state.sequence, head, weights, *poses)


def decode_control_state(data: bytes) -> ControlState:
    """Read a control state.

    Raises:
        DecodeError: The bytes are not a valid control state.
    """
    reader = Reader(data)
    reader.expect(MessageType.CONTROL_STATE)
    head = reader.record(CONTROL_STATE, "control_state")
    check_limit("num_lights", int(head["num_lights"]), MAX_LIGHTS, HEADER_BYTES + 4)
    check_limit("num_objects", int(head["num_objects"]), MAX_OBJECTS, HEADER_BYTES + 6)
    start = reader.offset
    weights = [float(weight) for weight in reader.array("<f4", int(head["num_lights"]), "light_weights")]
    for i, weight in enumerate(weights):
        _require_weight(weight, f"light_weights[{i}]", start + 4 * i)
    poses = []
    for i in range(int(head["num_objects"])):
        start = reader.offset
        record = reader.record(OBJECT_POSE, f"object_pose[{i}]")
        position, quaternion = _read_pose(record, f"object_pose[{i}]", start + 4)
        poses.append(
            WirePose(pose_revision=int(record["pose_revision"]), position=position, quaternion=quaternion)
        )
    reader.end()
    return ControlState(
        sequence=reader.header.sequence,
        revision=int(head["revision"]),
        light_weights=tuple(weights),
        object_poses=tuple(poses),
    )


def encode_status(status: Status) -> bytes:
    """Write a status message.

    Raises:
        EncodeError: Too many cameras, or a negative age.
    """
    if len(status.camera_ages) > MAX_CAMERAS:
        raise EncodeError("camera_ages", expected=f"at most {MAX_CAMERAS}", found=len(status.camera_ages))
    for name, age in [
        ("light_age", status.light_age),
        *((f"camera_ages[{i}]", age) for i, age in enumerate(status.camera_ages)),
    ]:
        if age < 0:
            raise EncodeError(name, expected="at least 0, +infinity or NaN", found=age)
    head = write_record(
        STATUS,
        server_time_ns=status.server_time_ns,
        light_age=status.light_age,
        num_cameras=len(status.camera_ages),
        is_stale=int(status.is_stale),
    )
    return frame(MessageType.STATUS, status.sequence, head, np.asarray(status.camera_ages, "<f4").tobytes())


def decode_status(data: bytes) -> Status:
    """Read a status message.

    Raises:
        DecodeError: The bytes are not a valid status message.
    """
    reader = Reader(data)
    reader.expect(MessageType.STATUS)
    head = reader.record(STATUS, "status")
    check_limit("num_cameras", int(head["num_cameras"]), MAX_CAMERAS, HEADER_BYTES + 12)
    _require_flag(int(head["is_stale"]), "is_stale", HEADER_BYTES + 14)
    start = reader.offset
    ages = [float(age) for age in reader.array("<f4", int(head["num_cameras"]), "camera_ages")]
    light_age = float(head["light_age"])
    for name, age, offset in [
        ("light_age", light_age, HEADER_BYTES + 8),
        *((f"camera_ages[{i}]", age, start + 4 * i) for i, age in enumerate(ages)),
    ]:
        require(not age < 0, name, offset=offset, expected="at least 0, +infinity or NaN", found=age)
    reader.end()
    return Status(
        sequence=reader.header.sequence,
        server_time_ns=int(head["server_time_ns"]),
        light_age=light_age,
        camera_ages=tuple(ages),
        is_stale=bool(head["is_stale"]),
    )


def encode_client_message(message: ClientMessage) -> bytes:
    """Write a message from client to server.

    Raises:
        EncodeError: A number that is not allowed.
    """
    match message:
        case Ack():
            body = write_record(
                ACK,
                acknowledged_sequence=message.acknowledged_sequence,
                acknowledged_type=message.acknowledged_type,
            )
            return frame(MessageType.ACK, message.sequence, body)
        case Subscribe():
            body = write_record(SUBSCRIBE, encoding=message.encoding, wants_atlas=int(message.wants_atlas))
            return frame(MessageType.SUBSCRIBE, message.sequence, body)
        case SetObjectPose():
            _check_pose(message.position, message.quaternion, "set_object_pose")
            body = write_record(
                SET_OBJECT_POSE,
                object_index=message.object_index,
                position=message.position,
                quaternion=message.quaternion,
            )
            return frame(MessageType.SET_OBJECT_POSE, message.sequence, body)
        case SetLightWeight():
            if not 0 <= message.weight <= MAX_WEIGHT:
                raise EncodeError(
                    "set_light_weight.weight", expected=f"0 to {MAX_WEIGHT:g}", found=message.weight
                )
            body = write_record(SET_LIGHT_WEIGHT, light_index=message.light_index, weight=message.weight)
            return frame(MessageType.SET_LIGHT_WEIGHT, message.sequence, body)


def decode_client_message(data: bytes) -> ClientMessage:
    """Read any message that a client may send.

    Raises:
        DecodeError: The bytes are not a valid message from a client.
    """
    check_limit("message", len(data), MAX_CLIENT_MESSAGE_BYTES, 0)
    reader = Reader(data)
    sequence = reader.header.sequence
    message: ClientMessage
    match reader.header.message_type:
        case MessageType.ACK:
            raw = reader.record(ACK, "ack")
            allowed = (MessageType.LIGHT_PACKET, MessageType.ATLAS_TILES)
            found = int(raw["acknowledged_type"])
            require(
                found in allowed, "acknowledged_type", offset=HEADER_BYTES + 4, expected="1 or 2", found=found
            )
            message = Ack(
                sequence=sequence,
                acknowledged_type=MessageType(found),
                acknowledged_sequence=int(raw["acknowledged_sequence"]),
            )
        case MessageType.SUBSCRIBE:
            raw = reader.record(SUBSCRIBE, "subscribe")
            encoding = int(raw["encoding"])
            require(encoding in (0, 1), "encoding", offset=HEADER_BYTES, expected="0 or 1", found=encoding)
            _require_flag(int(raw["wants_atlas"]), "wants_atlas", HEADER_BYTES + 1)
            message = Subscribe(
                sequence=sequence, encoding=Encoding(encoding), wants_atlas=bool(raw["wants_atlas"])
            )
        case MessageType.SET_OBJECT_POSE:
            raw = reader.record(SET_OBJECT_POSE, "set_object_pose")
            position, quaternion = _read_pose(raw, "set_object_pose", HEADER_BYTES + 4)
            message = SetObjectPose(
                sequence=sequence,
                object_index=int(raw["object_index"]),
                position=position,
                quaternion=quaternion,
            )
        case MessageType.SET_LIGHT_WEIGHT:
            raw = reader.record(SET_LIGHT_WEIGHT, "set_light_weight")
            weight = float(raw["weight"])
            _require_weight(weight, "set_light_weight.weight", HEADER_BYTES + 4)
            message = SetLightWeight(sequence=sequence, light_index=int(raw["light_index"]), weight=weight)
        case other:
            require(
                False,
                "message_type",
                offset=6,
                expected="a message from a client (64 to 67)",
                found=other.name,
            )
            raise AssertionError
    reader.end()
    return message


def _check_pose(position: Vector3, quaternion: Quaternion, where: str) -> None:
    if not all(abs(value) <= MAX_COORDINATE for value in position):
        raise EncodeError(f"{where}.position", expected=f"at most {MAX_COORDINATE:g} m", found=position)
    norm = math.hypot(*quaternion)
    if not abs(norm - 1) <= UNIT_TOLERANCE:
        raise EncodeError(f"{where}.quaternion", expected="a unit quaternion", found=quaternion)


def _read_pose(record: Any, where: str, offset: int) -> tuple[Vector3, Quaternion]:
    x, y, z = (float(value) for value in record["position"])
    a, b, c, d = (float(value) for value in record["quaternion"])
    near = all(abs(value) <= MAX_COORDINATE for value in (x, y, z))
    require(
        near, f"{where}.position", offset=offset, expected=f"at most {MAX_COORDINATE:g} m", found=(x, y, z)
    )
    norm = math.hypot(a, b, c, d)
    require(
        abs(norm - 1) <= UNIT_TOLERANCE,
        f"{where}.quaternion",
        offset=offset + 12,
        expected="a unit quaternion",
        found=(a, b, c, d),
    )
    return (x, y, z), (a, b, c, d)


def _require_weight(weight: float, where: str, offset: int) -> None:
    require(0 <= weight <= MAX_WEIGHT, where, offset=offset, expected=f"0 to {MAX_WEIGHT:g}", found=weight)


def _require_flag(value: int, where: str, offset: int) -> None:
    require(value in (0, 1), where, offset=offset, expected="0 or 1", found=value)
