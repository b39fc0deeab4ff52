"""The control state changes only as requests say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nearfield_protocol.codec import Ack, MessageType, SetLightWeight, SetObjectPose, Subscribe
from nearfield_server.bus.messages import ControlState
from nearfield_server.errors import BusError
from nearfield_server.records import ObjectPlacement
from nearfield_server.supervisor.control import apply_request, rigid_transform, want_atlas

STATE = ControlState(
    revision=5,
    light_weights=(1.0, 0.5),
    objects=(
        ObjectPlacement(revision=0, world_from_object=np.eye(4)),
        ObjectPlacement(revision=7, world_from_object=np.eye(4)),
    ),
)
MOVE = SetObjectPose(sequence=1, object_index=1, position=(1.0, 2.0, 3.0), quaternion=(0.0, 1.0, 0.0, 0.0))


def test_a_weight_changes_alone() -> None:
    state = apply_request(STATE, SetLightWeight(sequence=1, light_index=1, weight=2.0))
    assert (state.revision, state.light_weights) == (6, (1.0, 2.0))
    assert state.objects is STATE.objects


def test_a_pose_changes_with_its_revision_and_leaves_others() -> None:
    state = apply_request(STATE, MOVE)
    assert state.revision == 6
    assert state.objects[0] is STATE.objects[0]
    assert state.objects[1].revision == 8
    np.testing.assert_allclose(
        state.objects[1].world_from_object,
        [[-1, 0, 0, 1], [0, 1, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]],
        atol=1e-12,
    )


def test_requests_that_change_nothing_leave_the_very_same_state() -> None:
    moved = apply_request(STATE, MOVE)
    assert apply_request(moved, MOVE) is moved
    assert apply_request(STATE, SetLightWeight(sequence=1, light_index=0, weight=1.0)) is STATE
    assert want_atlas(STATE, False) is STATE


def test_the_wish_for_the_atlas_is_noted() -> None:
    state = apply_request(STATE, Subscribe(sequence=1, encoding=0, wants_atlas=True))  # type: ignore[arg-type]
    assert state.atlas_wanted
    assert state.revision == 6


def test_pose_revisions_wrap_to_32_bits() -> None:
    last = ControlState(
        revision=1,
        light_weights=(),
        objects=(ObjectPlacement(revision=0xFFFFFFFF, world_from_object=np.eye(4)),),
    )
    move = SetObjectPose(
        sequence=1, object_index=0, position=(1.0, 0.0, 0.0), quaternion=(0.0, 0.0, 0.0, 1.0)
    )
    assert apply_request(last, move).objects[0].revision == 0


@pytest.mark.parametrize(
    "message",
    [
        SetLightWeight(sequence=1, light_index=2, weight=1.0),
        SetObjectPose(sequence=1, object_index=2, position=(0.0, 0.0, 0.0), quaternion=(0.0, 0.0, 0.0, 1.0)),
        Ack(sequence=1, acknowledged_type=MessageType.LIGHT_PACKET, acknowledged_sequence=1),
    ],
)
def test_impossible_requests_are_refused(message: object) -> None:
    with pytest.raises(BusError, match="control/request"):
        apply_request(STATE, message)  # type: ignore[arg-type]


@given(
    st.tuples(*[st.floats(-100, 100)] * 3),
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: float(np.linalg.norm(q)) > 0.1),
)
def test_rotation_agrees_with_scipy(
    position: tuple[float, float, float], quaternion: tuple[float, ...]
) -> None:
    transform = rigid_transform(position, quaternion)  # type: ignore[arg-type]
    np.testing.assert_allclose(transform[:3, :3], Rotation.from_quat(quaternion).as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(transform[:, 3], [*position, 1])


@pytest.mark.parametrize(
    ("position", "quaternion"), [((0, 0, 0), (0, 0, 0, 0)), ((float("nan"), 0, 0), (0, 0, 0, 1))]
)
def test_poses_that_are_no_poses_are_refused(
    position: tuple[float, float, float], quaternion: tuple[float, float, float, float]
) -> None:
    with pytest.raises(BusError, match="object pose"):
        rigid_transform(position, quaternion)
