"""The room drawn from the streamed atlas: every chart shows its own radiance up to its rim, and edges are smooth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nearfield_protocol.codec import cut_tiles, encode_radiance, tile_changes

pytestmark = pytest.mark.browser

WIDTH, HEIGHT, FOV = 160, 120, 1.2
LOW, HIGH = np.array([-2.0, 0.0, -1.5]), np.array([2.0, 2.4, 3.0])
# One chart per face and tile; two rings around it repeat it, as the server writes them, and whatever lies beyond must never show.
ATLAS_WIDTH, ATLAS_HEIGHT, FIRST, SIDE, GUTTER, POISON = 96, 64, 4, 24, 2, 900.0


def _room(harness: Any) -> dict[str, Any]:
    room = harness.box(LOW.tolist(), HIGH.tolist(), [0.5, 0.5, 0.5], inward=True)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    cells = np.concatenate([_chart(face) + corners * SIDE for face in range(6)])
    room["uv"] = (cells / [ATLAS_WIDTH, ATLAS_HEIGHT]).ravel().tolist()
    return room


def _chart(face: int) -> NDArray[np.int64]:
    """First cell (column, row) of a face; faces in the order of `Harness.box`: -x +x -y +y -z +z."""
    return np.array([32 * (face % 3) + FIRST, 32 * (face // 3) + FIRST])


def _radiance(face: NDArray[np.int64], place: NDArray[np.float64], ramp: float) -> NDArray[np.float64]:
    """(..., 3): another colour on every face; it rises along both axes of the chart, each in a channel."""
    colours = np.array([[2, 1, 0.5], [0.5, 2, 1], [1, 0.5, 2], [3, 3, 1], [1, 3, 3], [4, 1, 4]])
    rise = np.stack([place[..., 0], place[..., 1], np.zeros_like(place[..., 0])], -1)
    return colours[face] * (1 + ramp * rise)


def _send_atlas(harness: Any, ramp: float) -> None:
    radiance = np.full((ATLAS_HEIGHT, ATLAS_WIDTH, 3), POISON)
    for face in range(6):
        column, row = _chart(face)
        cells = np.arange(-GUTTER, SIDE + GUTTER)
        u, v = np.meshgrid((cells + 0.5) / SIDE, (cells + 0.5) / SIDE)
        block = np.s_[row - GUTTER : row + SIDE + GUTTER, column - GUTTER : column + SIDE + GUTTER]
        radiance[block] = _radiance(np.full(u.shape, face), np.stack([u, v], -1), ramp)
    words = encode_radiance(radiance)
    positions = tile_changes(None, words)
    texels = cut_tiles(words, positions)
    harness.call("setAtlas", ATLAS_WIDTH, ATLAS_HEIGHT, positions.ravel().tolist(), texels.ravel().tolist())


def _camera() -> NDArray[np.float64]:
    """OpenCV axes in world axes, turned so that no room edge is parallel to the pixels."""
    forward = np.array([0.35, -0.12, -1.0])
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.05, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = (
        right,
        np.cross(forward, right),
        forward,
        [0.1, 1.3, 2.4],
    )
    return pose


def _expected(
    pose: NDArray[np.float64], ramp: float, factor: int = 1
) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Face (H, W) and radiance (H, W, 3) at the centres of pixels `factor` times as fine."""
    focal = HEIGHT / 2 / np.tan(FOV / 2)
    x, y = np.meshgrid(
        (np.arange(factor * WIDTH) + 0.5) / factor - WIDTH / 2,
        (np.arange(factor * HEIGHT) + 0.5) / factor - HEIGHT / 2,
    )
    rays = np.stack([x / focal, y / focal, np.ones_like(x)], -1) @ pose[:3, :3].T
    walls = np.where(rays > 0, HIGH, LOW)
    distance = (walls - pose[:3, 3]) / rays
    axis = np.argmin(distance, axis=-1)
    points = pose[:3, 3] + rays * np.take_along_axis(distance, axis[..., None], -1)
    share = (points - LOW) / (HIGH - LOW)
    place = np.stack(
        [np.take_along_axis(share, ((axis + step) % 3)[..., None], -1)[..., 0] for step in (1, 2)], -1
    )
    outward = np.take_along_axis(rays, axis[..., None], -1)[..., 0] > 0
    face = 2 * axis + outward
    return face, _radiance(face, place, ramp)


def _start(harness: Any, ramp: float, **more: object) -> NDArray[np.float64]:
    view = harness.view([0, 1, 2], [0, 1, 0], WIDTH, HEIGHT, 100.0)
    harness.create({"room": _room(harness), "objects": [], "views": [view], **more}, WIDTH, HEIGHT)
    pose = _camera()
    harness.call("setFreeCamera", pose.ravel().tolist(), FOV)
    _send_atlas(harness, ramp)
    return pose


def _is_interior(face: NDArray[Any]) -> NDArray[np.bool_]:
    """Pixels whose neighbours all show the same face."""
    return np.all(_neighbours(face) == face, axis=0)


def _neighbours(picture: NDArray[Any]) -> NDArray[Any]:
    """(9, H, W, ...): the 3 x 3 pixels around every pixel."""
    padded = np.pad(picture, [(1, 1), (1, 1)] + [(0, 0)] * (picture.ndim - 2), mode="edge")
    return np.stack([padded[y : y + HEIGHT, x : x + WIDTH] for y in range(3) for x in range(3)])


def test_a_known_atlas_shows_its_radiance_the_right_way_up(harness: Any) -> None:
    pose = _start(harness, ramp=0.8)
    picture = harness.picture()
    face, radiance = _expected(pose, ramp=0.8)
    assert len(np.unique(face)) == 4
    assert np.isfinite(picture).all()
    assert picture[..., 3].max() == 0
    interior = _is_interior(face)
    assert interior.mean() > 0.8
    error = np.abs(picture[..., :3] - radiance).max(-1)
    # RGB9_E5 errs by 0.2 % of the largest channel of a texel, half floats by 0.05 %.
    assert np.mean(error[interior] < 0.003 * radiance.max()) > 0.99
    # Where a face's two triangles meet, each shades at the middle of its own samples: within the pixel still.
    span = np.ptp(_neighbours(radiance), axis=0).max(-1)
    assert (error - 0.5 * span)[interior].max() < 0.003 * radiance.max()


def test_room_edges_are_smooth_without_seams(harness: Any) -> None:
    """Four samples per pixel: no rim shows what lies beyond its chart, and mixtures are as large as the faces' shares."""
    pose = _start(harness, ramp=0.0)
    picture = harness.picture()[..., :3]
    face, _ = _expected(pose, ramp=0.0)
    _, fine = _expected(pose, ramp=0.0, factor=8)
    exact = fine.reshape(HEIGHT, 8, WIDTH, 8, 3).mean((1, 3))
    contrast = np.ptp(fine, axis=(0, 1))
    rim = ~_is_interior(face)
    assert rim.sum() > 200
    error = np.abs(picture - exact)[rim] / contrast
    assert error.max() < 0.3
    assert error.mean() < 0.05


def test_new_tiles_redraw_the_room_and_nothing_behind_it(harness: Any) -> None:
    _start(harness, ramp=0.0)
    harness.picture()
    _send_atlas(harness, ramp=0.5)
    ran = {each["name"] for each in harness.call("render")["passes"] if each["ran"]}
    assert ran == {"room", "display"}


def test_a_lost_context_brings_the_streamed_room_back(harness: Any) -> None:
    _start(harness, ramp=0.8)
    before = harness.picture()
    harness.call("loseContext")
    np.testing.assert_array_equal(harness.picture(), before)


def test_the_room_behind_a_silhouette_is_its_own(harness: Any) -> None:
    """A black object before the lit room: every pixel is (1 - coverage) times the room that the object hides."""
    _start(harness, ramp=0.0)
    empty = harness.picture()
    _start(harness, ramp=0.0, objects=[harness.sphere([0.5, 1.1, 0.6], 0.3)])
    harness.call("setLight", [], [0.0] * 27)
    picture = harness.picture()
    assert (picture[..., 3] == 1).sum() > 200
    np.testing.assert_allclose(picture[..., :3], (1 - picture[..., 3:]) * empty[..., :3], atol=2e-3)


def test_faces_thinner_than_a_pixel_show_nothing_beyond_their_chart(harness: Any) -> None:
    """A board's narrow sides cover a part of some pixels only: what is looked up must still lie within the board."""
    room = _room(harness)
    board = harness.box([-0.4, 0.5, 0.0], [0.4, 1.7, 0.01], [0.5, 0.5, 0.5], inward=False)
    joined = harness.join(room, board)
    joined["uv"] = room["uv"] * 2
    view = harness.view([0, 1, 2], [0, 1, 0], WIDTH, HEIGHT, 100.0)
    harness.create({"room": joined, "objects": [], "views": [view]}, WIDTH, HEIGHT)
    _send_atlas(harness, ramp=0.0)
    for turn in np.linspace(-0.2, 0.2, 5):
        pose = _camera()
        pose[0, 3] += 4 * turn
        harness.call("setFreeCamera", pose.ravel().tolist(), FOV)
        picture = harness.picture()[..., :3]
        assert picture.max() <= 4.02
        # The darkest face has 3.5 in all channels together.
        assert picture.sum(axis=-1).min() >= 3.48
