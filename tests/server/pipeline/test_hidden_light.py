from dataclasses import replace

import numpy as np
import pytest

from nearfield_server.pipeline.gather import block_maxima
from nearfield_server.pipeline.hidden_light import (
    HiddenLight,
    estimate_hidden_radiance,
    find_hidden_light,
    write_hidden_radiance,
)
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.records import CameraFrame, LightSettings, RoomMesh
from nearfield_server.reference.box_room import BoxRoom, make_box_room

ALBEDO = 0.5


class NothingToRepeat:
    texels = np.zeros(0, dtype=np.int32)
    source = np.zeros(0, dtype=np.int32)


@pytest.fixture(scope="module")
def small_room() -> BoxRoom:
    return make_box_room(atlas_size=60, num_cameras=2, camera_size=256)


@pytest.fixture(scope="module")
def transport(small_room: BoxRoom) -> np.ndarray:
    """(N, N) irradiance on texel i per unit radiance of texel j; rows sum to pi, as in a closed room."""
    position = small_room.texels.position.astype(np.float64)
    normal = small_room.texels.normal.astype(np.float64)
    offset = position[None] - position[:, None]
    squared = np.maximum((offset**2).sum(axis=2), 1e-12)
    cosines = np.maximum(np.einsum("ijk,ik->ij", offset, normal), 0.0)
    cosines *= np.maximum(-np.einsum("ijk,jk->ij", offset, normal), 0.0)
    area = small_room.texels.area.astype(np.float64)
    matrix = cosines * area / (squared * (squared + area / np.pi))
    return matrix * (np.pi / matrix.sum(axis=1, keepdims=True))


def _lamp(room: BoxRoom, x: float, z: float, half: float = 0.35) -> np.ndarray:
    position, normal = room.texels.position, room.texels.normal
    return (normal[:, 1] < -0.5) & (np.abs(position[:, 0] - x) < half) & (np.abs(position[:, 2] - z) < half)


def _solve(transport: np.ndarray, emitted: np.ndarray, albedo: np.ndarray) -> np.ndarray:
    """Radiance in equilibrium; emitters do not reflect."""
    radiance = emitted.copy()
    for _ in range(25):
        radiance = emitted + albedo / np.pi * (transport @ radiance)
    return radiance


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
    radiance = _solve(transport, emitted, albedo)
    radiance[hidden] = 0.0
    return radiance.astype(np.float32), hidden


def _mesh(room: BoxRoom) -> RoomMesh:
    return room.mesh(ALBEDO)


def _find(room: BoxRoom, hidden: np.ndarray) -> HiddenLight:
    found = find_hidden_light(_mesh(room), room.texels, hidden, room)
    assert found is not None
    return found


def _dark(found: HiddenLight) -> np.ndarray:
    return np.zeros(found.num_groups, dtype=bool)


@pytest.mark.parametrize("colour", [(20.0, 18.0, 15.0), (2.0, 5.0, 60.0), (200.0, 200.0, 200.0)])
def test_a_hidden_lamp_is_found_with_its_colour(
    small_room: BoxRoom, transport: np.ndarray, colour: tuple[float, float, float]
) -> None:
    radiance, hidden = _case(small_room, transport, np.array(colour))
    found = _find(small_room, hidden)
    assert found.num_groups == 1
    estimate = estimate_hidden_radiance(found, radiance, _dark(found))
    # Coarse texels and 16 x 16 probes; a channel that carries little of the light is known less well.
    np.testing.assert_allclose(estimate[0], colour, rtol=0.1, atol=0.05 * max(colour))


@pytest.mark.parametrize("albedo_error", [0.0, 0.1, -0.1])
def test_a_dark_hidden_surface_stays_dark(
    small_room: BoxRoom, transport: np.ndarray, albedo_error: float
) -> None:
    radiance, hidden = _case(small_room, transport, np.zeros(3), albedo_error)
    found = _find(small_room, hidden)
    assert not estimate_hidden_radiance(found, radiance, _dark(found)).any()


def test_nothing_shines_in_the_dark(small_room: BoxRoom) -> None:
    hidden = _lamp(small_room, 1.5, 2.0)
    found = _find(small_room, hidden)
    black = np.zeros((hidden.size, 3), dtype=np.float32)
    assert not estimate_hidden_radiance(found, black, ~_dark(found)).any()


def test_scales_with_the_light(small_room: BoxRoom, transport: np.ndarray) -> None:
    radiance, hidden = _case(small_room, transport, np.array([30.0, 30.0, 30.0]))
    found = _find(small_room, hidden)
    once = estimate_hidden_radiance(found, radiance, _dark(found))
    np.testing.assert_allclose(
        estimate_hidden_radiance(found, radiance * np.float32(0.25), _dark(found)), 0.25 * once, rtol=1e-5
    )


def test_noise_does_not_switch_it(small_room: BoxRoom, transport: np.ndarray) -> None:
    radiance, hidden = _case(small_room, transport, np.array([30.0, 30.0, 30.0]))
    found = _find(small_room, hidden)
    shining = estimate_hidden_radiance(found, radiance, _dark(found)).sum(axis=1) > 0.0
    rng = np.random.default_rng(1)
    values = []
    for _ in range(20):
        noisy = (radiance * rng.normal(1.0, 0.01, radiance.shape)).astype(np.float32)
        values.append(estimate_hidden_radiance(found, noisy, shining)[0])
    assert (np.min(values, axis=0) > 0.0).all()
    assert (np.std(values, axis=0) < 0.03 * np.mean(values, axis=0)).all()


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


def test_nothing_hidden_gives_nothing(small_room: BoxRoom) -> None:
    none = np.zeros(small_room.texels.area.size, dtype=bool)
    assert find_hidden_light(_mesh(small_room), small_room.texels, none, small_room) is None


def test_black_receivers_are_of_no_use(small_room: BoxRoom) -> None:
    hidden = _lamp(small_room, 1.5, 2.0)
    assert find_hidden_light(small_room.mesh(0.01), small_room.texels, hidden, small_room) is None


def test_written_radiance_reaches_texels_and_block_maxima(small_room: BoxRoom) -> None:
    hidden = _lamp(small_room, 1.5, 2.0)
    found = _find(small_room, hidden)
    radiance = np.full((hidden.size, 3), 0.5, dtype=np.float32)
    maxima = block_maxima(radiance)
    write_hidden_radiance(found.texels, found.group, np.array([[1.0, 2.0, 3.0]]), radiance, maxima)
    np.testing.assert_array_equal(radiance[hidden], np.tile(np.float32([1, 2, 3]), (hidden.sum(), 1)))
    assert (radiance[~hidden] == 0.5).all()
    np.testing.assert_array_equal(maxima, block_maxima(radiance))


def test_the_pipeline_makes_a_light_of_it(small_room: BoxRoom, transport: np.ndarray) -> None:
    radiance, hidden = _case(small_room, transport, np.array([30.0, 30.0, 30.0]))

    def field(points: np.ndarray, face: np.ndarray) -> np.ndarray:
        return radiance[small_room.texel_at(points)].astype(np.float64)

    table = small_room.table
    keep = ~np.repeat(hidden, np.diff(table.pair_start))
    counts = np.where(hidden, 0, np.diff(table.pair_start))
    table = replace(
        table,
        pair_start=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        **{
            name: getattr(table, name)[keep]
            for name in ("camera", "pixel", "fraction_x", "fraction_y", "weight")
        },
    )
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
        table,
        LightSettings(),
        probe_rays=small_room,
        backend="cpu",
        unseen_fill=NothingToRepeat(),
    )
    update = pipeline.update(frames, [])
    near = np.linalg.norm(update.vals["position"] - [1.5, 3.0, 2.0], axis=1) < 0.6
    area = small_room.texels.area[hidden].sum()
    np.testing.assert_allclose(update.vals["radiant_intensity"][near].sum(axis=0), 30.0 * area, rtol=0.15)
