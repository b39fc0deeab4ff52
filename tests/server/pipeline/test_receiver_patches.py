import numpy as np
import pytest

from nearfield_server.pipeline.receiver_patches import PATCH_TEXELS, find_patches
from nearfield_server.reference.box_room import BoxRoom, make_box_room


@pytest.fixture(scope="module")
def fine_room() -> BoxRoom:
    return make_box_room(atlas_size=120, num_cameras=1, camera_size=16)


def _patches(room: BoxRoom, receiver: np.ndarray, reach: float) -> np.ndarray:
    usable = np.ones(room.texels.area.size, dtype=bool)
    return find_patches(room.mesh(), room.texels, usable, receiver, np.full(receiver.size, reach))


def test_patches_lie_within_reach_on_the_receivers_own_wall(fine_room: BoxRoom) -> None:
    texels = fine_room.texels
    receiver = np.random.default_rng(1).choice(texels.area.size, 200, replace=False).astype(np.int32)
    patch = _patches(fine_room, receiver, 0.4)
    distance = np.linalg.norm(texels.position[patch] - texels.position[receiver][:, None], axis=2)
    assert (distance <= 0.4).all()
    np.testing.assert_array_equal(
        texels.face[patch], np.repeat(texels.face[receiver][:, None], PATCH_TEXELS, 1)
    )


def test_away_from_borders_texels_surround_the_receiver(fine_room: BoxRoom) -> None:
    texels = fine_room.texels
    inside = np.abs(texels.position - fine_room.size * [0.5, 0.0, 0.5]).max(axis=1) < 0.5
    receiver = np.flatnonzero(inside & (texels.normal[:, 1] > 0.5)).astype(np.int32)
    assert receiver.size
    patch = _patches(fine_room, receiver, 0.5)
    # Coarse texels (17 x 7 cm) stand for more than one point of the disc now and then.
    assert all(np.unique(row).size >= 0.7 * PATCH_TEXELS for row in patch)
    offset = texels.position[patch].mean(axis=1) - texels.position[receiver]
    # A radiance that changes linearly over the patch is averaged to that of its centre, up to half a texel.
    assert np.linalg.norm(offset, axis=1).max() < 0.09


def test_a_patch_of_nothing_else_is_the_receiver_itself(fine_room: BoxRoom) -> None:
    receiver = np.array([0, 77, 500], dtype=np.int32)
    np.testing.assert_array_equal(
        _patches(fine_room, receiver, 0.0), np.repeat(receiver[:, None], PATCH_TEXELS, 1)
    )


def test_noise_of_pixels_is_averaged_away(fine_room: BoxRoom) -> None:
    receiver = np.flatnonzero(
        np.abs(fine_room.texels.position - fine_room.size * [0.5, 0.0, 0.5]).max(axis=1) < 0.5
    )
    patch = _patches(fine_room, receiver.astype(np.int32), 0.5)
    noise = np.random.default_rng(3).normal(1.0, 0.01, (400, fine_room.texels.area.size))
    # Sixteen independent texels: a quarter of the noise of one; some repeat.
    assert noise[:, patch].mean(axis=2).std(axis=0).max() < 0.01 / 2.5
