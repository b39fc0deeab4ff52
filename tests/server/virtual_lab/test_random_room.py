"""Rooms drawn at random: every seed gives a room that can be traced, and the same one each time."""

from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.virtual_lab.presets import build_scene
from nearfield_server.virtual_lab.random_room import MAX_LIGHTS, build_random_room

SEEDS = range(24)


@pytest.mark.parametrize("seed", SEEDS)
def test_lights_shine_into_the_room(seed: int) -> None:
    scene = build_random_room(seed)
    assert 1 <= len(scene.lights) <= MAX_LIGHTS
    for number, light in enumerate(scene.lights):
        (emitter,) = [item for item in scene.quads if item.light == number]
        in_front = emitter.p0 + 0.5 * (emitter.e1 + emitter.e2) + 0.01 * emitter.normal
        assert (in_front > 0.0).all()
        assert (in_front < scene.size).all()
        # The power is drawn within a decade, whatever the size of the lamp.
        assert 1.0 <= np.pi * emitter.area * max(light.radiance) <= 10.0 * (1.0 + 1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_everything_is_inside(seed: int) -> None:
    scene = build_random_room(seed)
    for sensor in (*scene.cameras, *scene.views):
        assert (sensor.world_from_camera[:3, 3] > 0.0).all()
        assert (sensor.world_from_camera[:3, 3] < scene.size).all()
    for item in scene.objects:
        assert (item.positions_world > 0.0).all()
        assert (item.positions_world < scene.size).all()
    corners = np.concatenate([[q.p0, q.p0 + q.e1, q.p0 + q.e2, q.p0 + q.e1 + q.e2] for q in scene.quads])
    assert (corners > -1e-9).all()
    assert (corners < np.asarray(scene.size) + 1e-9).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_materials_reflect_less_than_arrives(seed: int) -> None:
    scene = build_random_room(seed)
    assert {quad.material for quad in scene.quads} <= set(scene.materials)
    assert all(0.0 <= value <= 0.85 for albedo in scene.materials.values() for value in albedo)


@pytest.mark.parametrize("seed", SEEDS)
def test_some_light_is_on_in_every_frame(seed: int) -> None:
    scene = build_random_room(seed)
    (sequence,) = scene.sequences
    assert sequence.weights.shape[1] == len(scene.lights)
    assert sequence.weights.any(axis=1).all()
    assert (sequence.weights >= 0.0).all()


def test_objects_do_not_overlap() -> None:
    pairs = [build_random_room(seed).objects for seed in SEEDS]
    assert any(len(items) == 2 for items in pairs)
    assert any(len(items) == 1 for items in pairs)
    for items in pairs:
        if len(items) == 2:
            first, second = (item.positions_world[:, 0] for item in items)
            assert first.max() < second.min()


def test_equal_seeds_give_equal_rooms() -> None:
    first, second, other = (build_scene("random", None, seed) for seed in (5, 5, 6))
    assert first.name == second.name == "random_5"
    assert first.lights == second.lights
    assert len(first.quads) == len(second.quads)
    for a, b in zip(first.quads, second.quads, strict=True):
        np.testing.assert_array_equal(np.stack([a.p0, a.e1, a.e2]), np.stack([b.p0, b.e1, b.e2]))
    assert first.size != other.size
