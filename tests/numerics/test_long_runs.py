"""Hours of updates: no drift of sums, no worn-out identities, no growth, wrap-around of every counter.

In CI a thousand updates; with `--hypothesis-profile=long` a hundred thousand (about ten minutes).
"""

from __future__ import annotations

import gc
import resource
import sys
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from nearfield_protocol.codec import decode_light_packet
from nearfield_server.illumination.packet import PacketWriter
from nearfield_server.pipeline.clustering import empty_state, update_clusters
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.records import CameraFrame, LightSettings, LightUpdate, ObjectPose
from nearfield_server.reference.box_room import BoxRoom, lamp_field, make_box_room

LAMPS = (
    (3, (0.3, 0.4), (0.2, 0.2), (40.0, 38.0, 30.0)),
    (0, (0.5, 0.6), (0.2, 0.2), (10.0, 12.0, 15.0)),
)
STATES = ((True, True), (False, True), (True, False), (True, True), (False, False))
STEADY = 40
"""Updates between two switches of a lamp."""
SETTLING = 5
"""Updates after a switch in which k-means may still find a better use for a slot."""
JUMP = 0.25
"""Metres beyond which a light counts as another one (coarse texels of 0.6 m here: moments may lie as far apart again)."""


@dataclass
class Household:
    """A small room whose lamps are switched all day long under noisy cameras."""

    room: BoxRoom = field(default_factory=lambda: make_box_room(atlas_size=30, num_cameras=2, camera_size=24))

    def __post_init__(self) -> None:
        rng = np.random.default_rng(5)
        self.pictures = {}
        for on in set(STATES):
            lit = lamp_field(
                self.room,
                tuple(lamp for lamp, shines in zip(LAMPS, on, strict=True) if shines),
                0.1 + sum(on),
            )
            clean = [self.room.picture(index, lit) for index in range(2)]
            self.pictures[on] = [[self._noisy(picture, rng) for picture in clean] for _ in range(7)]
        self.pose = ObjectPose(
            object_index=0,
            revision=1,
            world_from_object=np.eye(4),
            centre_object=np.array([2.0, 1.0, 1.5]),
            radius=0.1,
        )

    @staticmethod
    def _noisy(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        noisy = picture.copy()
        noisy[..., :3] *= rng.normal(1.0, 0.01, (*picture.shape[:2], 1)).astype(np.float16)
        return noisy

    def pipeline(self) -> LightPipeline:
        return LightPipeline(
            self.room.mesh(),
            self.room.texels,
            self.room.table,
            LightSettings(num_vals=8, num_samples=128),
            probe_rays=self.room,
            backend="cpu",
        )

    def update(self, pipeline: LightPipeline, number: int) -> LightUpdate:
        on = STATES[number // STEADY % len(STATES)]
        frames = [
            CameraFrame(
                camera_index=index,
                sequence=number,
                content_revision=number,
                timestamp_ns=33_333_333 * number,
                pixels=pixels,
            )
            for index, pixels in enumerate(self.pictures[on][number % 7])
        ]
        return pipeline.update(frames, [self.pose])


@pytest.fixture(scope="module")
def household() -> Household:
    return Household()


def test_a_day_of_switching_under_noise(household: Household, long_run: bool) -> None:
    updates = 100_000 if long_run else 1000
    pipeline = household.pipeline()
    writer = PacketWriter(
        bounds_min=np.full(3, -1e-3, np.float32),
        bounds_size=(household.room.size + 2e-3).astype(np.float32),
        room_revision=1,
        sequence=2**32 - 1 - updates // 2,
    )
    memory = []
    before: LightUpdate | None = None
    for number in range(updates):
        update = household.update(pipeline, number)
        direct = _direct(pipeline, household.room, update)
        total = update.vals["radiant_intensity"].sum(axis=0, dtype=np.float64)
        np.testing.assert_allclose(total, direct, rtol=1e-6)  # the sums of float32 records
        if before is not None:
            _check_identities(before, update, settled=number % STEADY >= SETTLING)
        before = update
        packet = decode_light_packet(writer.write(update, [household.pose]))
        assert packet.sequence == (2**32 - updates // 2 + number) % 2**32
        assert packet.timestamp_ns == 33_333_333 * number
        if number % (updates // 5) == updates // 5 - 1:
            gc.collect()
            memory.append((sys.getallocatedblocks(), _resident_bytes()))
    # The first fifths fill caches; what comes after does not grow with the number of updates.
    assert memory[-1][0] - memory[1][0] < 500
    assert memory[-1][1] - memory[1][1] < 8_000_000
    fresh = household.pipeline()
    again = household.update(fresh, updates - 1)
    np.testing.assert_array_equal(update.threshold, again.threshold)
    np.testing.assert_array_equal(update.object_sh, again.object_sh)
    np.testing.assert_array_equal(pipeline.texel_radiance, fresh.texel_radiance)


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _direct(pipeline: LightPipeline, room: BoxRoom, update: LightUpdate) -> np.ndarray:
    radiance = pipeline.texel_radiance.astype(np.float64)
    return (np.where(radiance >= update.threshold, radiance, 0.0) * room.texels.area[:, None]).sum(axis=0)


def _check_identities(before: LightUpdate, after: LightUpdate, settled: bool) -> None:
    """A slot of the same generation is the same light: it stays where it was, and noise renews nothing."""
    lit = before.vals["radiant_intensity"].any(axis=1) & after.vals["radiant_intensity"].any(axis=1)
    same = lit & (before.vals["generation"] == after.vals["generation"])
    distance = np.linalg.norm(after.vals["position"] - before.vals["position"], axis=1)
    assert (distance[same] <= 2.0 * JUMP).all()
    if settled:
        np.testing.assert_array_equal(before.vals["generation"], after.vals["generation"])
        assert (distance[lit] < 0.05).all()


def test_slots_of_lamps_that_take_turns(long_run: bool) -> None:
    """Generations wrap many times; every slot serves a lamp, and consecutive lights of a slot have other generations."""
    rng = np.random.default_rng(6)
    corners = np.array([[0.5, 3, 0.5], [5.5, 3, 0.5], [0.5, 3, 3.5], [5.5, 3, 3.5]])
    state = empty_state(8)
    states = []
    for _ in range(100_000 if long_run else 1000):
        on = corners[rng.random(4) < 0.5]
        position = np.repeat(on, 16, axis=0) + rng.uniform(-0.2, 0.2, (16 * len(on), 3)) * [1, 0, 1]
        points = np.concatenate([position, np.broadcast_to([0.0, -0.5, 0.0], position.shape)], axis=1)
        states = [*states[-1:], state := update_clusters(state, points, 20)]
        assert np.isfinite(state.centres).all()
        nearest = np.linalg.norm(on[:, None] - state.centres[None, state.alive, :3], axis=2)
        assert (nearest.min(axis=1, initial=np.inf) < 0.3).all()
        for old, new in pairwise(states):
            same = old.alive & new.alive & (old.generation == new.generation)
            moved = np.linalg.norm(new.centres[:, :3] - old.centres[:, :3], axis=1)
            assert (moved[same] <= JUMP).all()
