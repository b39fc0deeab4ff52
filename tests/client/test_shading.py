"""Shading against closed forms, and differential rendering against its definition."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytestmark = pytest.mark.browser

WIDTH, HEIGHT = 112, 84


def _furnished_scene(harness: Any, background: NDArray[np.float32] | None = None) -> dict[str, Any]:
    """A closed room with a table; one sphere on the table, one on the floor behind it."""
    view = harness.view([1.4, 1.5, 2.6], [-0.1, 0.45, 0.0], WIDTH, HEIGHT, 110.0)
    if background is not None:
        view["background"] = np.asarray(background[..., :3], float).ravel().tolist()
    return {
        "room": harness.join(
            harness.box([-2, 0, -2], [2, 2.4, 3], [0.7, 0.6, 0.5], inward=True),
            harness.box([-0.5, 0.0, -0.3], [0.5, 0.5, 0.4], [0.4, 0.5, 0.6], inward=False),
        ),
        "objects": [harness.sphere([0.1, 0.68, 0.0], 0.18), harness.sphere([-0.6, 0.25, -0.7], 0.25)],
        "views": [view],
    }


def _many_vals(harness: Any, count: int) -> list[dict[str, Any]]:
    """Discs on the ceiling and three walls, unequal in size and colour."""
    rng = np.random.default_rng(7)
    vals = []
    for i in range(count):
        radius, radiance = rng.uniform(0.02, 0.3), rng.uniform(0.2, 8.0, 3)
        a, b = rng.uniform(-1.7, 1.7, 2)
        height = rng.uniform(0.4, 2.0)
        place, normal = [
            ([a, 2.39, b], [0, -1, 0]),
            ([-1.99, height, a], [1, 0, 0]),
            ([1.99, height, a], [-1, 0.0, 0]),
            ([a, height, -1.99], [0, 0, 1]),
        ][i % 4]
        vals.append(harness.val(place, normal, radius, radiance.tolist()))
    return vals


@pytest.mark.parametrize("count", [5, 64])
def test_tiles_change_no_bit(harness: Any, count: int) -> None:
    pictures = _with_and_without_tiles(harness, count, fullQuality=True)
    assert pictures[0].max() > 0.1
    np.testing.assert_array_equal(pictures[0].view(np.uint32), pictures[1].view(np.uint32))


@pytest.mark.parametrize("shadows", [False, True])
def test_live_fragments_share_the_vals_without_bias(harness: Any, shadows: bool) -> None:
    """Shares are means over neighbours: what curves within a fragment or two is smoothed, nothing is added or lost."""
    shared, own = _with_and_without_tiles(harness, 24, scale=3, shadows=shadows, antiAliasing=False)
    is_virtual = own[..., 3] == 1
    np.testing.assert_array_equal(shared[..., 3], own[..., 3])
    difference = (shared - own)[..., :3]
    assert np.abs(difference[is_virtual]).mean() < 0.03 * own[is_virtual, :3].mean()
    assert abs(difference[is_virtual].mean()) < 0.01 * own[is_virtual, :3].mean()
    assert np.abs(difference[~is_virtual]).mean() < 0.5 / 255
    if not shadows:
        np.testing.assert_array_equal(difference[~is_virtual], 0.0)


def test_vals_left_out_of_a_live_tile_stay_below_half_a_step_of_white(harness: Any) -> None:
    shared, own = _with_and_without_tiles(harness, 64, share=2e-3, shadows=False, antiAliasing=False)
    lost = (own - shared)[..., :3]
    assert lost.max() > 1e-4
    # What is not left out is smoothed a little.
    assert np.abs(lost).max() < 1.1 * 0.5 / 255


def _with_and_without_tiles(
    harness: Any, count: int, scale: int = 1, share: float = 1.0, **options: object
) -> list[NDArray[np.float32]]:
    background = np.full((HEIGHT, WIDTH, 3), 2.0, np.float32)
    harness.create(_furnished_scene(harness, background), scale * WIDTH, scale * HEIGHT, **options)
    vals = _many_vals(harness, count)
    for val in vals:
        val["radiantIntensity"] = [share * value for value in val["radiantIntensity"]]
    harness.call("setLight", vals, [0.3] * 54)
    pictures = []
    for tiled in (True, False):
        harness.call("setOptions", {"tiled": tiled})
        pictures.append(harness.picture())
    return pictures


def test_composite_of_a_lit_room_is_the_augmented_room(harness: Any) -> None:
    """Eq. 13 on a background made by the same light equals drawing the augmented room (Eq. 12 everywhere)."""
    options = {"antiAliasing": False, "indirectOcclusion": False, "fullQuality": True}
    vals = _many_vals(harness, 16)
    harness.create(_furnished_scene(harness), WIDTH, HEIGHT, **options)
    harness.call("setLight", vals, [0.0] * 54)
    pictures = {}
    for mode in ("room", "augmented"):
        harness.call("setMode", mode)
        pictures[mode] = harness.picture()
    harness.create(_furnished_scene(harness, pictures["room"]), WIDTH, HEIGHT, **options)
    harness.call("setLight", vals, [0.0] * 54)
    composite, augmented = harness.picture(), pictures["augmented"]
    is_real = augmented[..., 3] == 0
    shadow = np.abs(pictures["room"] - augmented)[is_real, :3].max()
    assert shadow > 0.05
    assert 0.005 < 1 - is_real.mean() < 0.5
    np.testing.assert_allclose(composite[..., :3], augmented[..., :3], rtol=0, atol=1e-6)


def test_background_picture_passes_unchanged(harness: Any) -> None:
    """Without light and objects the composite is the background, in the orientation and to the precision of its file."""
    picture = np.random.default_rng(3).uniform(0, 5, (HEIGHT, WIDTH, 4)).astype(np.float32)
    scene = _furnished_scene(harness, picture)
    scene["objects"] = []
    harness.create(scene, WIDTH, HEIGHT)
    np.testing.assert_allclose(harness.picture()[..., :3], picture[..., :3], rtol=3e-7)


def test_disc_on_a_plane_equals_the_closed_form(harness: Any) -> None:
    view = harness.view([0, 2.0, 0.0], [0, 0, 0], 97, 97, 60.0)
    scene = {"room": harness.floor(albedo=0.75), "objects": [], "views": [view]}
    harness.create(scene, 97, 97, antiAliasing=False)
    height, radius, radiance = 0.4, 0.25, 7.0
    harness.call("setLight", [harness.val([0, height, 0], [0, -1, 0], radius, radiance)], [])
    harness.call("setMode", "room")
    found = harness.picture()[..., 0]
    x = harness.floor_points(view)
    to_val = np.array([0, height, 0]) - x
    squared = np.sum(to_val**2, axis=-1)
    cosine = height / np.sqrt(squared)
    intensity, area = radiance * np.pi * radius**2, np.pi * radius**2
    expected = 0.75 / np.pi * intensity * cosine**2 / (squared + area / np.pi)
    np.testing.assert_allclose(found, expected, rtol=2e-4)
    # On the axis the disc form is the exact irradiance pi L R^2 / (R^2 + h^2).
    near = np.argmin(np.hypot(x[..., 0], x[..., 2]))
    exact = 0.75 * radiance * radius**2 / (radius**2 + height**2)
    assert found.ravel()[near] == pytest.approx(exact, rel=2e-3)


def test_uniform_light_on_a_convex_object_is_its_albedo(harness: Any) -> None:
    """White furnace: under radiance 2 from everywhere a convex object shows albedo * 2, however it is turned."""
    scene = {
        "room": harness.floor(),
        "objects": [harness.sphere([0, 1, 0], 0.4, albedo=0.6, isConvex=True)],
        "views": [harness.view([0, 1.2, 2], [0, 1, 0], 80, 60, 100.0)],
    }
    harness.create(scene, 80, 60, antiAliasing=False)
    sh = np.zeros((9, 3))
    sh[0] = 2.0 * np.sqrt(4 * np.pi)
    harness.call("setLight", [], sh.ravel().tolist())
    picture = harness.picture()
    inside = picture[..., 3] == 1
    assert inside.sum() > 500
    # Radiance stands in a half float.
    np.testing.assert_allclose(picture[inside, :3], 1.2, rtol=1e-3)


def test_indirect_light_does_not_turn_with_the_object(harness: Any) -> None:
    scene = {
        "room": harness.floor(),
        "objects": [harness.sphere([0, 1, 0], 0.4, isConvex=True)],
        "views": [harness.view([0, 1.2, 2], [0, 1, 0], 80, 60, 100.0)],
    }
    harness.create(scene, 80, 60, antiAliasing=False)
    rng = np.random.default_rng(5)
    sh = rng.uniform(-0.3, 0.3, (9, 3))
    sh[0] = 4.0
    harness.call("setLight", [], sh.ravel().tolist())
    first = harness.picture()
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = [0, 1, 0]
    harness.call("setPose", 0, pose.ravel().tolist())
    second = harness.picture()
    both = (first[..., 3] == 1) & (second[..., 3] == 1)
    assert first[both, :3].std() > 0.02
    # Half floats, and another tessellation in every turn.
    np.testing.assert_allclose(second[both, :3], first[both, :3], atol=4e-3)


@pytest.mark.parametrize(("full_quality", "rim"), [(True, 0.0), (False, 0.1)])
def test_indirect_exchange_equals_the_closed_form(harness: Any, full_quality: bool, rim: float) -> None:
    """A field that is the same everywhere: albedo / pi * E_block * (left * L_object - L_hidden) on the floor under it.

    Live fragments take means over their neighbours, so there the law holds up to two fragments (0.1 m) from where the field ends.
    """
    o = np.array([0.9, 0.5, 0.1, -0.2, 0.0, 0.1, -0.1, 0.05, 0.0], np.float16).astype(float)
    field = {"boxMin": [-0.5, -1.2, -0.5], "boxSize": [1.0, 1.6, 1.0], "coeffs": o.tolist()}
    albedo = 0.6
    view = harness.view([0, 2.5, 0.001], [0, 0, 0], 64, 64, 60.0)
    background = np.full((64, 64, 3), 2.0, np.float32)
    view["background"] = background.ravel().tolist()
    scene = {
        "room": harness.floor(albedo=0.5),
        "objects": [harness.sphere([0, 1, 0], 0.05, albedo=albedo, isConvex=True, field=field)],
        "views": [view],
    }
    harness.create(scene, 64, 64, antiAliasing=False, fullQuality=full_quality)
    sh = np.array([4.0, 0.5, -0.3, 0.2, 0.1, -0.2, 0.3, 0.05, 0.1])
    harness.call("setLight", [], np.repeat(sh, 3).tolist())
    kernel = np.array([np.pi] + [2 * np.pi / 3] * 3 + [np.pi / 4] * 5)
    direction = np.array([o[3], o[1], o[2]]) / np.linalg.norm(o[1:4])
    blocked = np.sum(kernel * o * _sh_basis(0, 1, 0))
    hidden = sh @ _sh_basis(*direction)
    # What faces the floor is lit by a floor that keeps only what the object leaves it.
    left = 1 - blocked / np.pi * max(0.0, direction[1])
    bounced = left * albedo / np.pi * np.sum(kernel * sh * _sh_basis(*-direction))
    expected = 2.0 + 0.5 / np.pi * blocked * (bounced - hidden)
    picture = harness.picture()
    x = harness.floor_points(view)
    inside = (np.abs(x[..., 0]) < 0.38 - rim) & (np.abs(x[..., 2]) < 0.38 - rim) & (picture[..., 3] == 0)
    outside = (np.abs(x[..., 0]) > 0.51 + rim) | (np.abs(x[..., 2]) > 0.51 + rim)
    assert abs(expected - 2.0) > 0.1
    np.testing.assert_allclose(picture[inside, :3], expected, rtol=2e-4)
    np.testing.assert_array_equal(picture[outside, :3], 2.0)


def test_indirect_exchange_between_two_virtual_objects(harness: Any) -> None:
    """A convex object in the field of another: its irradiance changes by E_block * (left * L_other - L_hidden), by its normal."""
    o = np.array([0.8, -0.4, 0.1, 0.2, 0.05, 0.1, -0.1, 0.05, 0.1], np.float16).astype(float)
    field = {"boxMin": [-1.0, -2.0, -1.0], "boxSize": [2.0, 4.0, 2.0], "coeffs": o.tolist()}
    albedos, centre, radius, side = (0.7, 0.6), np.array([0, 0.6, 0]), 0.25, 96
    view = harness.view([0.3, 1.0, 1.6], centre.tolist(), side, side, 180.0)
    view["background"] = np.zeros(3 * side * side).tolist()
    objects = [
        harness.sphere([0, 1.5, 0], 0.05, albedo=albedos[0], isConvex=True, field=field),
        harness.sphere(centre.tolist(), radius, albedo=albedos[1], isConvex=True, rings=96),
    ]
    scene = {"room": harness.floor(), "objects": objects, "views": [view]}
    harness.create(scene, side, side, antiAliasing=False)
    sh = np.array(
        [[5.0, 0.5, -0.3, 0.2, 0.1, -0.2, 0.3, 0.05, 0.1], [4.0, -0.4, 0.3, 0.1, 0.2, 0, -0.1, 0.2, 0]]
    )
    harness.call("setLight", [], np.repeat(sh.ravel(), 3).tolist())
    picture = harness.picture()
    pose = np.reshape(view["worldFromCamera"], (4, 4))
    x, y = np.meshgrid(np.arange(side) - view["cx"], np.arange(side) - view["cy"])
    rays = np.stack([x / view["fx"], y / view["fy"], np.ones_like(x)], -1) @ pose[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    to_centre = centre - pose[:3, 3]
    along = rays @ to_centre
    apart = to_centre @ to_centre - along**2
    # Away from the silhouette, where the polygons of the sphere would show.
    inside = (apart < (0.9 * radius) ** 2) & (picture[..., 3] == 1)
    hit = along - np.sqrt(np.maximum(radius**2 - apart, 0))
    normal = (hit[..., None] * rays - to_centre)[inside] / radius
    basis = _sh_basis(*normal.T).T
    kernel = np.array([np.pi] + [2 * np.pi / 3] * 3 + [np.pi / 4] * 5)
    direction = np.array([o[3], o[1], o[2]]) / np.linalg.norm(o[1:4])
    blocked = np.clip(basis @ (kernel * o), 0, np.pi)
    bounced = albedos[0] / np.pi * np.sum(kernel * sh[0] * _sh_basis(*-direction))
    left = 1 - blocked / np.pi * np.maximum(0, normal @ direction)
    irradiance = basis @ (kernel * sh[1]) + blocked * (left * bounced - sh[0] @ _sh_basis(*direction))
    assert inside.sum() > 1000
    assert np.ptp(blocked) > 0.5
    np.testing.assert_allclose(picture[inside, 0], albedos[1] / np.pi * irradiance, atol=3e-3)


def _sh_basis(x: Any, y: Any, z: Any) -> NDArray[np.float64]:
    return np.array(
        [
            0.28209479177387814 + 0 * x,
            0.4886025119029199 * y,
            0.4886025119029199 * z,
            0.4886025119029199 * x,
            1.0925484305920792 * x * y,
            1.0925484305920792 * y * z,
            0.31539156525252005 * (3 * z * z - 1),
            1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
        ]
    )
