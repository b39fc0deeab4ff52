"""The link between bus and hub, with a bus that is a dictionary."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from nearfield_protocol import codec
from nearfield_protocol.session import ClientSession
from nearfield_server.bus.messages import ControlState
from nearfield_server.gateway.bus_link import BusLink, light_health
from nearfield_server.gateway.hub import LightHub
from nearfield_server.gateway.pose import wire_pose
from nearfield_server.records import ObjectPlacement
from nearfield_server.supervisor.control import rigid_transform

from .conftest import atlas_bytes, light_bytes


class FakeBus:
    def __init__(self) -> None:
        self.sent: list[tuple[str, bytes, bool]] = []
        self.callbacks: dict[str, Callable[[str, bytes], None]] = {}

    def put(self, key: str, payload: bytes, *, must_arrive: bool = False) -> None:
        self.sent.append((key, payload, must_arrive))

    def subscribe(self, key: str, callback: Callable[[str, bytes], None]) -> None:
        self.callbacks[key] = callback


@pytest.fixture
def linked() -> Iterator[tuple[FakeBus, LightHub, BusLink]]:
    bus, hub = FakeBus(), LightHub()
    link = BusLink(bus, hub)
    yield bus, hub, link
    link.close()


Linked = tuple[FakeBus, LightHub, BusLink]


def everything(hub: LightHub) -> list:
    """All that a new client is sent."""
    client, session, received = hub.join(), ClientSession(), []
    while (data := client.session.next_message(0.0)) is not None:
        received.append(session.receive(data))
    hub.leave(client)
    return received


async def test_light_states_and_statuses_reach_clients(linked: Linked) -> None:
    bus, hub, link = linked
    pose = rigid_transform((1.0, 2.0, 3.0), (0.0, 0.6, 0.0, -0.8))
    state = ControlState(
        revision=4, light_weights=(0.5,), objects=(ObjectPlacement(revision=2, world_from_object=pose),)
    )
    status = {"light_age_s": 0.25, "stale": False, "cameras": [{"age_s": 0.1}, {"age_s": None}]}
    for _ in range(2):
        bus.callbacks["control/state"]("control/state", state.to_json())
    bus.callbacks["light/packet"]("light/packet", b"")
    bus.callbacks["light/packet"]("light/packet", light_bytes(3))
    bus.callbacks["status/*"]("status/illumination", json.dumps(status).encode())
    control, heartbeat, light = everything(hub)
    assert control.revision == 4
    assert control.sequence == 1
    assert control.object_poses[0].pose_revision == 2
    np.testing.assert_allclose(control.object_poses[0].quaternion, (0.0, -0.6, 0.0, 0.8), atol=1e-7)
    assert heartbeat.light_age == pytest.approx(0.25, abs=0.2)
    assert heartbeat.camera_ages[1] == float("inf")
    assert light.sequence == 3
    assert link.statuses()["illumination"]["stale"] is False


def test_requests_go_to_the_supervisor(linked: Linked) -> None:
    bus, hub, link = linked
    link.request(codec.SetLightWeight(sequence=1, light_index=2, weight=0.5))
    assert hub.on_atlas_wanted is not None
    hub.on_atlas_wanted(True)
    link.close()
    first, second = (codec.decode_client_message(payload) for _, payload, _ in bus.sent)
    assert first == codec.SetLightWeight(sequence=1, light_index=2, weight=0.5)
    assert isinstance(second, codec.Subscribe)
    assert second.wants_atlas
    assert [(key, must) for key, _, must in bus.sent] == [("control/request", True)] * 2


async def test_broken_payloads_are_left_out(linked: Linked) -> None:
    bus, hub, _ = linked
    bus.callbacks["light/packet"]("light/packet", b"junk")
    bus.callbacks["light/atlas"]("light/atlas", light_bytes(1))
    bus.callbacks["light/atlas"]("light/atlas", atlas_bytes(1, [(0, 0)]))
    assert hub.light is None
    assert [type(message) for message in everything(hub)] == [codec.Status]


def test_health_of_a_process_that_prepares() -> None:
    assert light_health({"phase": "starting"}, time.monotonic()) is None


@pytest.mark.parametrize("seed", range(20))
def test_pose_round_trip(seed: int) -> None:
    rng = np.random.default_rng(seed)
    quaternion = rng.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    if seed == 0:
        quaternion = np.array([1.0, 0.0, 0.0, 0.0])
    transform = rigid_transform(tuple(rng.uniform(-5, 5, 3)), tuple(quaternion))
    pose = wire_pose(1, transform)
    np.testing.assert_allclose(rigid_transform(pose.position, pose.quaternion), transform, atol=1e-12)
    assert pose.quaternion[3] >= 0
