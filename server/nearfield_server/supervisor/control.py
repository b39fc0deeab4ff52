"""The one place where the control state changes: requests of clients in, states out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.codec import ClientMessage, SetLightWeight, SetObjectPose, Subscribe
from nearfield_server.bus.messages import ControlState
from nearfield_server.errors import BusError
from nearfield_server.records import ObjectPlacement
from nearfield_server.scene.room_config import RoomConfig


def initial_state(room: RoomConfig) -> ControlState:
    """Return what the room file says: weights and poses at start, revision 1, poses at revision 0."""
    return ControlState(
        revision=1,
        light_weights=tuple(light.weight for light in room.lights),
        objects=tuple(
            ObjectPlacement(revision=0, world_from_object=np.asarray(item.world_from_object, np.float64))
            for item in room.objects
        ),
    )


def rigid_transform(
    position: tuple[float, float, float], quaternion: tuple[float, float, float, float]
) -> NDArray[np.float64]:
    """Return the (4, 4) float64 transform of a position in metres and a quaternion x, y, z, w, which is normalised here.

    Raises:
        BusError: the quaternion is 0, or a number is not finite.
    """
    x, y, z, w = np.asarray(quaternion, np.float64) / max(float(np.linalg.norm(quaternion)), 1e-300)
    transform = np.eye(4)
    transform[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    transform[:3, 3] = position
    if not np.isfinite(transform).all() or abs(x * x + y * y + z * z + w * w - 1) > 1e-6:
        raise BusError(
            f"object pose: position {position}, quaternion {quaternion}; expected finite numbers and a unit quaternion"
        )
    return transform


def apply_request(state: ControlState, message: ClientMessage) -> ControlState:
    """Return the state after a request; the very same object if it changes nothing.

    Raises:
        BusError: the message names a light or object that does not exist, or is no control request.
    """
    match message:
        case SetLightWeight(light_index=index, weight=weight):
            _check_index("light", index, len(state.light_weights))
            if state.light_weights[index] == weight:
                return state
            weights = (*state.light_weights[:index], weight, *state.light_weights[index + 1 :])
            return replace(state, revision=state.revision + 1, light_weights=weights)
        case SetObjectPose(object_index=index, position=position, quaternion=quaternion):
            _check_index("object", index, len(state.objects))
            old = state.objects[index]
            transform = rigid_transform(position, quaternion)
            if np.array_equal(transform, old.world_from_object):
                return state
            new = ObjectPlacement(revision=(old.revision + 1) & 0xFFFFFFFF, world_from_object=transform)
            objects = (*state.objects[:index], new, *state.objects[index + 1 :])
            return replace(state, revision=state.revision + 1, objects=objects)
        case Subscribe(wants_atlas=wanted):
            return want_atlas(state, wanted)
        case _:
            raise BusError(f"control/request: {type(message).__name__} is no control request")


def want_atlas(state: ControlState, wanted: bool) -> ControlState:
    """Return the state with the wish for the atlas noted."""
    return (
        state
        if state.atlas_wanted == wanted
        else replace(state, revision=state.revision + 1, atlas_wanted=wanted)
    )


def _check_index(kind: str, index: int, count: int) -> None:
    if not 0 <= index < count:
        raise BusError(f"control/request: {kind} {index} does not exist; the room has {count}")
