"""Soft shadows of disc lights against numerical integration of the visible part of the disc."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytestmark = pytest.mark.browser

SIZE = 128
EYE = [0.0, 3.0, 1.2]


def _disc_points(
    position: list[float], normal: list[float], radius: float, count: int
) -> NDArray[np.float64]:
    n = np.asarray(normal, float) / np.linalg.norm(normal)
    first = np.cross(n, [1.0, 0, 0] if abs(n[0]) < 0.7 else [0, 1.0, 0])
    first /= np.linalg.norm(first)
    i = np.arange(count)
    r, angle = radius * np.sqrt((i + 0.5) / count), 2.399963229728653 * i
    return (
        np.asarray(position)
        + (r * np.cos(angle))[:, None] * first
        + (r * np.sin(angle))[:, None] * np.cross(n, first)
    )


def _visible_share(
    points: NDArray[np.float64], lights: NDArray[np.float64], centre: list[float], radius: float
) -> NDArray[np.float64]:
    """Share of the light's points that each receiver sees past a sphere."""
    seen = np.zeros(points.shape[:-1])
    for light in lights:
        ray = light - points
        along = np.clip(np.sum((centre - points) * ray, -1) / np.sum(ray * ray, -1), 0, 1)
        nearest = points + along[..., None] * ray
        seen += np.linalg.norm(nearest - centre, axis=-1) > radius
    return seen / len(lights)


def _shadow(harness: Any, sphere: tuple[list[float], float], val: dict[str, Any], **options: object) -> Any:
    view = harness.view(EYE, [0, 0, 0.05], SIZE, SIZE, 150.0)
    scene = {"room": harness.floor(), "objects": [harness.sphere(*sphere)], "views": [view]}
    harness.create(scene, SIZE, SIZE, antiAliasing=False, **options)
    harness.call("setLight", [val], [0.0] * 27)
    pictures = {}
    for mode in ("room", "augmented"):
        harness.call("setMode", mode)
        pictures[mode] = harness.picture()
    is_real = pictures["augmented"][..., 3] == 0
    lit, free = pictures["augmented"][..., 0], pictures["room"][..., 0]
    return view, is_real, np.divide(lit, free, out=np.ones_like(lit), where=is_real)


@pytest.mark.parametrize(
    ("place", "radius", "light", "normal", "disc"),
    [
        ([0, 0.5, 0], 0.2, [0.3, 2.0, -0.2], [0, -1, 0], 0.15),
        ([0, 0.2, 0], 0.2, [0.5, 1.8, -0.3], [-0.3, -1, 0.2], 0.25),
        ([0, 0.6, 0], 0.15, [0.0, 2.2, 0.0], [0, -1, 0], 0.02),
    ],
    ids=["floating", "standing", "small light"],
)
def test_penumbra_follows_the_integral_over_the_disc(
    harness: Any, place: list[float], radius: float, light: list[float], normal: list[float], disc: float
) -> None:
    """Percentage-closer soft shadows from one map err where blockers differ in depth: mean error over the shadow below 0.03."""
    val = harness.val(light, normal, disc, 5.0)
    view, is_real, found = _shadow(harness, (place, radius), val, fullQuality=True)
    lights = _disc_points(light, normal, disc, 256)
    expected = _visible_share(harness.floor_points(view), lights, place, radius)
    shadowed = is_real & (expected < 1)
    assert shadowed.sum() > 200
    error = np.abs(found - expected)
    assert error[shadowed].mean() < 0.03
    assert error[is_real & (expected == 0)].max(initial=0.0) < 0.05
    # Outside the penumbra nothing darkens at all.
    assert found[is_real & (expected == 1)].min() > 0.98


def test_live_quality_shows_the_same_shadow(harness: Any) -> None:
    """Fewer taps and the small maps: noisier, but without bias."""
    place, radius, light, disc = [0, 0.5, 0], 0.2, [0.3, 2.0, -0.2], 0.15
    val = harness.val(light, [0, -1, 0], disc, 5.0)
    view, is_real, found = _shadow(harness, (place, radius), val)
    expected = _visible_share(
        harness.floor_points(view), _disc_points(light, [0, -1, 0], disc, 256), place, radius
    )
    shadowed = is_real & (expected < 1)
    assert np.abs(found - expected)[shadowed].mean() < 0.05
    assert abs((found - expected)[shadowed].mean()) < 0.02


def test_a_flat_receiver_and_a_lit_sphere_do_not_shade_themselves(harness: Any) -> None:
    val = harness.val([0.8, 1.2, 0.6], [-0.8, -1.2, -0.6], 0.1, 5.0)
    place, radius = [0, 0.4, 0], 0.2
    view = harness.view(EYE, [0, 0, 0.05], SIZE, SIZE, 150.0)
    scene = {"room": harness.floor(), "objects": [harness.sphere(place, radius)], "views": [view]}
    harness.create(scene, SIZE, SIZE, antiAliasing=False)
    harness.call("setLight", [val], [0.0] * 27)
    shadowed = harness.picture()
    harness.call("setMode", "room")
    floor = harness.picture()
    harness.call("setOptions", {"shadows": False})
    floor_free = harness.picture()
    harness.call("setMode", "composite")
    free = harness.picture()
    is_real = free[..., 3] == 0
    np.testing.assert_array_equal(floor[is_real], floor_free[is_real])
    # A sphere lit by a small light shades only what is turned away from it, which is dark anyway.
    lit = free[(free[..., 3] == 1) & (free[..., 0] > 0.3 * free[free[..., 3] == 1, 0].max()), 0]
    kept = shadowed[(free[..., 3] == 1) & (free[..., 0] > 0.3 * free[free[..., 3] == 1, 0].max()), 0]
    assert lit.size > 200
    np.testing.assert_allclose(kept, lit, rtol=0.02)


def test_real_furniture_shades_virtual_objects_once(harness: Any) -> None:
    """A virtual ball in the shadow of a real board is dark, and the floor behind it is not darkened a second time."""
    board = harness.box([-1, 1.0, -1], [1, 1.05, 1], [0.5, 0.5, 0.5], inward=False)
    view = harness.view([0, 0.7, 3.0], [0, 0.3, 0], SIZE, SIZE, 150.0)
    background = np.full((SIZE, SIZE, 3), 0.5, np.float32)
    view["background"] = background.ravel().tolist()
    scene = {
        "room": harness.join(harness.floor(), board),
        "objects": [harness.sphere([0, 0.3, 0], 0.2)],
        "views": [view],
    }
    harness.create(scene, SIZE, SIZE, antiAliasing=False)
    harness.call("setLight", [harness.val([0, 2.2, 0], [0, -1, 0], 0.1, 20.0)], [0.0] * 27)
    picture = harness.picture()
    is_virtual = picture[..., 3] == 1
    assert picture[is_virtual, 0].max() < 1e-3
    np.testing.assert_allclose(picture[~is_virtual, 0], 0.5, atol=1e-3)
