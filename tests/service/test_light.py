"""Frames go in, light comes out, and requests change it."""

from __future__ import annotations

import time

import numpy as np
import pytest
from tests.service.harness import Service

from nearfield_protocol.codec import (
    SetLightWeight,
    SetObjectPose,
)

pytestmark = pytest.mark.service


def _light(service: Service) -> np.ndarray:
    """Sums that do not depend on how light is divided among slots, which remembers the past."""
    packet = service.newest_packet()
    return np.concatenate([packet.vals["radiant_intensity"].sum(0), packet.object_sh.ravel()])


def test_packets_carry_finite_light_for_every_object(service: Service) -> None:
    _, packet = service.packet_after(0.0)
    assert packet.object_sh.shape == (1, 9, 3)
    assert np.isfinite(packet.object_sh).all()
    assert packet.object_sh[0, 0].min() > 0
    assert np.isfinite(packet.vals["radiant_intensity"]).all()
    assert packet.vals["radiant_intensity"].sum() > 0
    assert (packet.bounds_size > 0).all()


def test_without_change_the_same_packet_is_only_repeated(service: Service) -> None:
    at, first = service.packet_after(0.0)
    at, second = service.packet_after(at)
    _, third = service.packet_after(at)
    assert first.sequence == second.sequence == third.sequence
    np.testing.assert_array_equal(first.object_sh, third.object_sh)


def test_dimming_all_lights_scales_the_light_and_back(service: Service) -> None:
    """Light is linear: half the weight of every lamp is half of all radiance, up to the half floats of the frames."""
    service.packet_after(0.0)
    before = _light(service)

    def dim(weight: float) -> None:
        for index in range(2):
            service.request(SetLightWeight(sequence=1, light_index=index, weight=weight))

    def scaled(factor: float) -> bool:
        return np.allclose(_light(service), before * factor, rtol=2e-2, atol=1e-3 * np.abs(before).max())

    service.until("half the light", lambda: dim(0.5), lambda: scaled(0.5))
    service.until("the old light", lambda: dim(1.0), lambda: scaled(1.0))


def test_moving_an_object_changes_its_sh_and_names_the_pose(service: Service) -> None:
    _, packet = service.packet_after(0.0)
    before = packet.object_sh.copy()
    move = SetObjectPose(
        sequence=1, object_index=0, position=(0.4, 0.5, 0.4), quaternion=(0.0, 0.0, 0.0, 1.0)
    )
    revision = int(packet.object_revisions[0])

    def moved() -> bool:
        return int(service.newest_packet().object_revisions[0]) > revision

    service.until("the new pose", lambda: service.request(move), moved)
    assert not np.allclose(service.newest_packet().object_sh, before, rtol=1e-2)


def test_refused_requests_change_nothing_and_are_logged(service: Service) -> None:
    service.packet_after(0.0)
    sequence = service.newest_packet().sequence
    service.until(
        "a refusal",
        lambda: service.request(SetLightWeight(sequence=1, light_index=40, weight=1.0)),
        lambda: "light 40 does not exist" in service.log_text(),
    )
    service.bus.put("control/request", b"\x00\x01", must_arrive=True)
    at, _ = service.packet_after(time.monotonic())
    service.packet_after(at)
    assert service.newest_packet().sequence == sequence


def test_status_tells_ages_stages_and_sources(service: Service) -> None:
    status = service.status("illumination", phase="running")
    assert [camera["stale"] for camera in status["cameras"]] == [False, False]
    assert {stage["name"] for stage in status["stages"]} >= {"gather", "cluster", "integrate", "sh"}
    camera = service.status("cam0", phase="running")
    assert camera["connected"] is True
    assert camera["source"]["kind"] == "lab"
    assert camera["frames"] > 0
