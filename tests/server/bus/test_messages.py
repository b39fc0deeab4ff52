"""Control state over the wire and back, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.bus.keys import room_prefix
from nearfield_server.bus.messages import ControlState, status_json
from nearfield_server.errors import BusError
from nearfield_server.records import ObjectPlacement

finite = st.floats(allow_nan=False, allow_infinity=False)


@given(
    st.integers(0, 2**63),
    st.lists(st.floats(0, 1e6), max_size=4),
    st.lists(st.tuples(st.integers(0, 2**32), st.lists(finite, min_size=16, max_size=16)), max_size=3),
    st.booleans(),
)
def test_round_trip_is_exact(
    revision: int, weights: list[float], objects: list[tuple[int, list[float]]], atlas_wanted: bool
) -> None:
    state = ControlState(
        revision=revision,
        light_weights=tuple(weights),
        objects=tuple(
            ObjectPlacement(revision=r, world_from_object=np.array(m).reshape(4, 4)) for r, m in objects
        ),
        atlas_wanted=atlas_wanted,
    )
    back = ControlState.from_json(state.to_json())
    assert (back.revision, back.light_weights, back.atlas_wanted) == (revision, tuple(weights), atlas_wanted)
    assert len(back.objects) == len(objects)
    for got, sent in zip(back.objects, state.objects, strict=True):
        assert got.revision == sent.revision
        np.testing.assert_array_equal(got.world_from_object, sent.world_from_object)


VALID = {"revision": 1, "light_weights": [1.0], "objects": [], "atlas_wanted": False}


@pytest.mark.parametrize(
    "change",
    [
        {"revision": None},
        {"light_weights": [-1]},
        {"light_weights": [float("nan")]},
        {"light_weights": 3},
        {"objects": [{"revision": 1, "world_from_object": [1, 2]}]},
        {"objects": [{"revision": 1}]},
    ],
)
def test_malformed_states_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(BusError, match="control/state: malformed"):
        ControlState.from_json(json.dumps({**VALID, **change}).encode())


@pytest.mark.parametrize("payload", [b"", b"\xff", b"[]", b"1"])
def test_other_bytes_are_refused(payload: bytes) -> None:
    with pytest.raises(BusError, match="control/state"):
        ControlState.from_json(payload)


@given(st.text())
def test_room_names_never_hold_key_syntax(room: str) -> None:
    assert not set(room_prefix(room).removeprefix("nearfield/")) & set("/*$?#@ ")


def test_status_messages_are_json_that_browsers_read() -> None:
    status = {
        "age": float("inf"),
        "nested": [{"x": np.float32(0.5), "n": np.int64(3)}, float("nan")],
        "ok": True,
        "none": None,
    }
    text = status_json(status).decode()
    strict = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert strict == {"age": None, "nested": [{"x": 0.5, "n": 3}, None], "ok": True, "none": None}
