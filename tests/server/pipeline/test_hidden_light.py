from dataclasses import replace

import numpy as np
import pytest

from nearfield_server.pipeline.hidden_light import (
    HiddenLight,
    estimate_hidden_radiance,
    explain_receivers,
    find_hidden_light,
    texels_without_source,
)
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.records import CameraFrame, LightSettings, RoomMesh, UnseenFill
from nearfield_server.reference.box_room import BoxRoom, hide_texels, make_box_room
from nearfield_server.reference.hidden_light import estimate_hidden_radiance_reference
from nearfield_server.reference.radiosity import equilibrium_radiance, transport_matrix

ALBEDO = 0.5


@pytest.fixture(scope="module")
def small_room() -> BoxRoom:
    return make_box_room(atlas_size=60, num_cameras=2, camera_size=256)


@pytest.fixture(scope="module")
def transport(small_room: BoxRoom) -> np.ndarray:
    return transport_matrix(small_room.texels)


def _lamp(room: BoxRoom, x: float, z: float, half: float = 0.35) -> np.ndarray:
    position, normal = room.texels.position, room.texels.normal
    return (normal[:, 1] < -0.5) & (np.abs(position[:, 0] - x) < half) & (np.abs(position[:, 2] - z) < half)


def _case(
    room: BoxRoom, transport: np.ndarray, hidden_radiance: np.ndarray, albedo_error: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """A seen lamp and a hidden one. Returns radiance as the cameras deliver it, and the hidden texels."""
    seen, hidden = _lamp(room, 4.5, 2.0), _lamp(room, 1.5, 2.0)
    emitted = np.zeros((seen.size, 3))
    emitted[seen] = [20.0, 18.0, 15.0]
    emitted[hidden] = hidden_radiance
    albedo = np.full((seen.size, 1), ALBEDO * (1.0 + albedo_error))
    albedo[seen | hidden] = 0.0
    radiance = equilibrium_radiance(transport, emitted, albedo)
    radiance[hidden] = 0.0
    return radiance.astype(np.float32), hidden


def _mesh(room: BoxRoom) -> RoomMesh:
    return room.mesh(ALBEDO)


def _find(room: BoxRoom, hidden: np.ndarray) -> HiddenLight:
    found = find_hidden_light(_mesh(room), room.texels, hidden, room)
    assert found is not None
    return found


@pytest.mark.parametrize("colour", [(20.0, 18.0, 15.0), (2.0, 5.0, 60.0), (200.0, 200.0, 200.0)])
def test_a_hidden_lamp_is_found_with_its_colour(
    small_room: BoxRoom, transport: np.ndarray, colour: tuple[float, float, float]
) -> None:
    radiance, hidden = _case(small_room, transport, np.array(colour))
    found = _find(small_room, hidden)
    assert found.num_groups == 1
    estimate = estimate_hidden_radiance(found, radiance)
    # Coarse texels and 16 x 16 probes; a channel that carries little of the light is known less well.
    np.testing.assert_allclose(estimate[0], colour, rtol=0.1, atol=0.05 * max(colour))


@pytest.mark.parametrize("albedo_error", [0.0, 0.1, -0.1])
def test_a_dark_hidden_surface_stays_dark(
    small_room: BoxRoom, transport: np.ndarray, albedo_error: float
) -> None:
    radiance, hidden = _case(small_room, transport, np.zeros(3), albedo_error)
    found = _find(small_room, hidden)
    assert not estimate_hidden_radiance(found, radiance).any()


def test_nothing_shines_in_the_dark(small_room: BoxRoom) -> None:
    hidden = _lamp(small_room, 1.5, 2.0)
    found = _find(small_room, hidden)
    black = np.zeros((hidden.size, 3), dtype=np.float32)
    assert not estimate_hidden_radiance(found, black).any()


def test_scales_with_the_light(small_room: BoxRoom, transport: np.ndarray) -> None:
    radiance, hidden = _case(small_room, transport, np.array([30.0, 30.0, 30.0]))
    found = _find(small_room, hidden)
    once = estimate_hidden_radiance(found, radiance)
    np.testing.assert_allclose(
        estimate_hidden_radiance(found, radiance * np.float32(0.25)), 0.25 * once, rtol=1e-5
    )


def test_noise_does_not_switch_it(small_room: BoxRoom, transport: np.ndarray) -> None:
    radiance, hidden = _case(small_room, transport, np.array([30.0, 30.0, 30.0]))
    found = _find(small_room, hidden)
    rng = np.random.default_rng(1)
    values = []
    for _ in range(20):
        noisy = (radiance * rng.normal(1.0, 0.01, radiance.shape)).astype(np.float32)
        values.append(estimate_hidden_radiance(found, noisy)[0])
    assert (np.min(values, axis=0) > 0.0).all()
    assert (np.std(values, axis=0) < 0.03 * np.mean(values, axis=0)).all()


def test_the_fast_estimate_agrees_with_the_float64_oracle(small_room: BoxRoom) -> None:
    """Whatever the atlas holds: many surfaces, some believed and some not, seen by each other's receivers."""
    mesh = _mesh(small_room)
    # Every wall is a surface of its own.
    split = replace(
        mesh,
        face_material=np.repeat(np.arange(6, dtype=np.int32), 2),
        materials=tuple("abcdef"),
        material_albedo=np.full((6, 3), ALBEDO),
    )
    lamps = _lamp(small_room, 1.5, 2.0) | (small_room.texels.normal[:, 0] > 0.5)
    lamps |= small_room.texels.normal[:, 2] < -0.5
    found = find_hidden_light(split, small_room.texels, lamps, small_room)
    assert found is not None
    assert found.num_groups == 3
    believed = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        radiance = rng.uniform(0.8, 1.2, (lamps.size, 3)) * rng.uniform(0.1, 3.0, (6, 3)).repeat(
            lamps.size // 6, axis=0
        )
        radiance = np.where(lamps[:, None], 0.0, radiance).astype(np.float32)
        estimate = estimate_hidden_radiance(found, radiance)
        np.testing.assert_allclose(
            estimate, estimate_hidden_radiance_reference(found, radiance), rtol=1e-9, atol=1e-12
        )
        believed += np.count_nonzero(estimate.any(axis=1))
    assert 0 < believed < 90


def test_belief_grows_with_the_evidence() -> None:
    found = HiddenLight(
        texels=np.zeros(1, dtype=np.int32),
        group=np.zeros(1, dtype=np.int32),
        receiver=np.arange(5, dtype=np.int32)[:, None],
        group_rows=np.array([0, 5]),
        inverse_albedo=np.full((5, 3), np.pi / ALBEDO),
        form_factor=np.full((5, 1), 0.1),
        ray_start=np.zeros(6, dtype=np.int64),
        ray_texel=np.zeros(0, dtype=np.int32),
        ray_weight=np.zeros(0, dtype=np.float32),
    )
    shown = np.full((5, 3), ALBEDO / np.pi, dtype=np.float32)
    for share, belief in ((0.19, 0.0), (0.25, 0.25), (0.3, 0.5), (0.35, 0.75), (0.41, 1.0)):
        value = explain_receivers(found, shown, np.full((5, 3), 1.0 - share))
        np.testing.assert_allclose(value, belief * 10.0 * share, rtol=1e-5)
    # Receivers that disagree: median deviation 0.35 of the median.
    missing = 0.5 * np.array([0.5, 0.65, 1.0, 1.35, 1.5])[:, None]
    np.testing.assert_allclose(
        explain_receivers(found, shown, 1.0 - missing.repeat(3, axis=1)), 0.5 * 5.0, rtol=1e-5
    )


def test_a_lamp_that_is_dimmed_never_pops(small_room: BoxRoom, transport: np.ndarray) -> None:
    bright, hidden = _case(small_room, transport, np.array([30.0, 30.0, 30.0]))
    dark, _ = _case(small_room, transport, np.zeros(3))
    found = _find(small_room, hidden)
    weights = np.linspace(0.0, 1.0, 201)
    values = [
        estimate_hidden_radiance(found, (w * bright + (1.0 - w) * dark).astype(np.float32))[0]
        for w in weights
    ]
    assert not values[0].any()
    np.testing.assert_allclose(values[-1], 30.0, rtol=0.1)
    # A jump from nothing to the accepted share would be 6 W/(sr m^2) or more; a steady step is 0.15, while belief grows 0.6.
    assert np.abs(np.diff(values, axis=0)).max() < 1.0
    assert (np.diff(values, axis=0) > -0.05).all()


def test_only_texels_without_a_source_are_searched() -> None:
    fill = UnseenFill(texel=np.array([4, 5, 6], np.int32), source=np.array([1, -1, 2], np.int32))
    assert np.flatnonzero(texels_without_source(fill, 8)).tolist() == [5]


def test_surfaces_of_other_materials_are_told_apart(small_room: BoxRoom) -> None:
    mesh = _mesh(small_room)
    material = mesh.face_material.copy()
    material[6:8] = 1
    split = replace(
        mesh, face_material=material, materials=("wall", "ceiling"), material_albedo=np.full((2, 3), ALBEDO)
    )
    ceiling = small_room.texels.normal[:, 1] < -0.5
    wall = small_room.texels.normal[:, 0] > 0.5
    found = find_hidden_light(split, small_room.texels, ceiling | wall, small_room)
    assert found is not None
    assert found.num_groups == 2
    for number in range(2):
        members = found.texels[found.group == number]
        assert ceiling[members].all() or wall[members].all()


def test_what_one_hidden_lamp_sends_to_the_receivers_of_another(small_room: BoxRoom) -> None:
    """A thin lamp far from a receiver must not fall between the pixels of a cube."""
    mesh = _mesh(small_room)
    material = mesh.face_material.copy()
    material[6:8] = 1
    split = replace(
        mesh, face_material=material, materials=("wall", "ceiling"), material_albedo=np.full((2, 3), ALBEDO)
    )
    position, normal = small_room.texels.position, small_room.texels.normal
    wall = normal[:, 0] > 0.5
    row = np.unique(position[wall, 1])[3]
    strip = wall & (np.abs(position[:, 1] - row) < 1e-3)
    found = find_hidden_light(split, small_room.texels, _lamp(small_room, 4.5, 2.0) | strip, small_room)
    assert found is not None
    assert found.num_groups == 2
    texels = small_room.texels
    receiver = texels.position[found.receiver].astype(np.float64).mean(axis=1)
    facing = texels.normal[found.receiver[:, 0]].astype(np.float64)
    for number in range(2):
        members = found.texels[found.group == number]
        offset = texels.position[members].astype(np.float64)[None] - receiver[:, None]
        squared = (offset**2).sum(axis=2)
        cosines = np.maximum(np.einsum("rmi,ri->rm", offset, facing), 0.0)
        cosines *= np.maximum(-np.einsum("rmi,mi->rm", offset, texels.normal[members]), 0.0)
        expected = (cosines / squared**2 * texels.area[members]).sum(axis=1)
        # The factor is that of the receiver itself, the sum that of the mean of its patch, which a wall may cut off.
        np.testing.assert_allclose(found.form_factor[:, number], expected, rtol=0.1, atol=1e-6)


def test_nothing_hidden_gives_nothing(small_room: BoxRoom) -> None:
    none = np.zeros(small_room.texels.area.size, dtype=bool)
    assert find_hidden_light(_mesh(small_room), small_room.texels, none, small_room) is None


def test_black_receivers_are_of_no_use(small_room: BoxRoom) -> None:
    hidden = _lamp(small_room, 1.5, 2.0)
    assert find_hidden_light(small_room.mesh(0.01), small_room.texels, hidden, small_room) is None


def test_the_pipeline_makes_a_light_of_it(small_room: BoxRoom, transport: np.ndarray) -> None:
    radiance, hidden = _case(small_room, transport, np.array([30.0, 30.0, 30.0]))

    def field(points: np.ndarray, face: np.ndarray) -> np.ndarray:
        return radiance[small_room.texel_at(points)].astype(np.float64)

    frames = [
        CameraFrame(
            camera_index=k,
            sequence=1,
            content_revision=1,
            timestamp_ns=1,
            pixels=small_room.picture(k, field),
        )
        for k in range(2)
    ]
    pipeline = LightPipeline(
        _mesh(small_room),
        small_room.texels,
        hide_texels(small_room.table, hidden),
        LightSettings(),
        probe_rays=small_room,
        backend="cpu",
        hidden_light=_find(small_room, hidden),
    )
    update = pipeline.update(frames, [])
    near = np.linalg.norm(update.vals["position"] - [1.5, 3.0, 2.0], axis=1) < 0.6
    area = small_room.texels.area[hidden].sum()
    np.testing.assert_allclose(update.vals["radiant_intensity"][near].sum(axis=0), 30.0 * area, rtol=0.15)


def test_a_receiver_reads_each_texel_once_in_order(small_room: BoxRoom, transport: np.ndarray) -> None:
    _, hidden = _case(small_room, transport, np.array([30.0, 30.0, 30.0]))
    found = _find(small_room, hidden)
    for first, last in zip(found.ray_start[:-1], found.ray_start[1:], strict=True):
        assert (np.diff(found.ray_texel[first:last]) > 0).all()
        # The half space holds pi of projected solid angle; the hidden lamp takes its part.
        assert 0.5 * np.pi < found.ray_weight[first:last].sum() <= np.pi * 1.001
