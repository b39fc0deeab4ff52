"""Rigid transforms as the wire has them: position and unit quaternion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nearfield_protocol.codec import ControlState, WirePose
from nearfield_server.bus.messages import ControlState as BusControlState


def wire_pose(revision: int, world_from_object: NDArray[np.float64]) -> WirePose:
    """Position in metres and quaternion x, y, z, w (w >= 0) of a rigid (4, 4) transform."""
    x, y, z = (float(value) for value in world_from_object[:3, 3])
    a, b, c, d = (
        float(value) for value in Rotation.from_matrix(world_from_object[:3, :3]).as_quat(canonical=True)
    )
    return WirePose(pose_revision=revision & 0xFFFFFFFF, position=(x, y, z), quaternion=(a, b, c, d))


def wire_control_state(state: BusControlState) -> ControlState:
    """The control state of the bus as clients get it; the hub numbers it."""
    return ControlState(
        sequence=0,
        revision=state.revision & 0xFFFFFFFF,
        light_weights=state.light_weights,
        object_poses=tuple(wire_pose(item.revision, item.world_from_object) for item in state.objects),
    )
