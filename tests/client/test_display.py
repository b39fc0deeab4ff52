"""What is drawn on the screen alone, other picture sizes, and the budget of a live frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytestmark = pytest.mark.browser

WIDTH, HEIGHT = 160, 120


def _start(harness: Any, **options: object) -> dict[str, Any]:
    view: dict[str, Any] = harness.view([0, 1.0, 2.5], [0, 0.5, 0], WIDTH, HEIGHT, 150.0)
    rows = np.linspace(0.1, 0.3, HEIGHT)[:, None, None]
    columns = np.linspace(0.0, 0.2, WIDTH)[None, :, None]
    view["background"] = ((rows + columns) * [1.0, 0.8, 0.6]).ravel().tolist()
    scene = {"room": harness.floor(), "objects": [harness.sphere([0, 0.5, 0], 0.3)], "views": [view]}
    harness.create(scene, WIDTH, HEIGHT, **options)
    harness.call("setLight", [harness.val([0.4, 0.6, 0.6], [0, 0, 1], 0.05, 1.0)], [0.2] * 27)
    return view


def _screen(harness: Any) -> NDArray[np.int64]:
    """What the canvas shows, sRGB (H, W, 3)."""
    width, height = harness.size
    data = harness.page.evaluate(
        """() => {
          // A canvas keeps its picture only until it was shown, so it is drawn anew.
          harness.setOptions({ exposure: 1.001 })
          while (harness.render().pending);
          harness.setOptions({ exposure: 1 })
          harness.render()
          const canvas = document.querySelector('canvas')
          const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d')
          copy.drawImage(canvas, 0, 0)
          return [...copy.getImageData(0, 0, canvas.width, canvas.height).data]
        }"""
    )
    return np.reshape(data, (height, width, 4))[..., :3]


def _toggled(harness: Any, change: dict[str, object], back: dict[str, object]) -> NDArray[np.bool_]:
    """Pixels of the screen that an option changes; asserts that the composite stays what it was, bit by bit."""
    composite = harness.picture()
    harness.call("setOptions", back)
    before = _screen(harness)
    harness.call("setOptions", change)
    after = _screen(harness)
    np.testing.assert_array_equal(harness.picture(), composite)
    harness.call("setOptions", back)
    np.testing.assert_array_equal(_screen(harness), before)
    changed: NDArray[np.bool_] = np.abs(after - before).max(axis=-1) > 8
    return changed


def _pixel(view: dict[str, Any], point: list[float]) -> NDArray[np.float64]:
    """Column and row of a world point."""
    pose = np.reshape(view["worldFromCamera"], (4, 4))
    x, y, z = pose[:3, :3].T @ (np.array(point) - pose[:3, 3])
    return np.array([view["fx"] * x / z + view["cx"], view["fy"] * y / z + view["cy"]])


def test_markers_of_area_lights_are_on_the_screen_only(harness: Any) -> None:
    view = _start(harness)
    changed = _toggled(harness, {"showVals": True}, {"showVals": False})
    column, row = _pixel(view, [0.4, 0.6, 0.6])
    rows, columns = np.nonzero(changed)
    assert changed[round(row), round(column)]
    # The disc and its normal, nothing far away.
    assert 10 < len(rows) < 1500
    assert np.hypot(rows - row, columns - column).max() < 50


def test_the_selected_object_is_outlined_on_the_screen_only(harness: Any) -> None:
    _start(harness)
    coverage = harness.picture()[..., 3]
    changed = _toggled(harness, {"selectedObject": 0}, {"selectedObject": -1})
    assert not changed[coverage == 1].any()
    padded = np.pad(coverage > 0, 1)
    beside = np.any([padded[y : y + HEIGHT, x : x + WIDTH] for y in range(3) for x in range(3)], axis=0)
    assert not changed[~beside].any()
    # One pixel wide all around: about the length of the outline.
    assert changed.sum() > 0.8 * 2 * np.sqrt(np.pi * coverage.sum())


@pytest.mark.parametrize("factor", [2, 0.5])
def test_another_size_shows_the_same_picture(harness: Any, factor: float) -> None:
    """The linear background keeps its values at the same places; the sphere covers the same share."""
    _start(harness)
    first = harness.picture()
    width, height = int(factor * WIDTH), int(factor * HEIGHT)
    harness.call("setSize", width, height)
    harness.size = (width, height)
    second = harness.picture()
    assert second[..., 3].mean() == pytest.approx(first[..., 3].mean(), rel=0.01)
    # Pixel centres of the new size in pixels of the old one; beyond the outermost centres a picture repeats its rim.
    x = np.clip((np.arange(width) + 0.5) / factor - 0.5, 0, WIDTH - 1)
    y = np.clip((np.arange(height) + 0.5) / factor - 0.5, 0, HEIGHT - 1)
    linear = 0.1 + 0.2 * y[:, None] / (HEIGHT - 1) + 0.2 * x[None, :] / (WIDTH - 1)
    # Above the sphere and its shadow.
    top = second[: int(0.2 * height), :, 0]
    np.testing.assert_allclose(top, linear[: len(top)], rtol=2e-3)


def test_a_live_frame_draws_at_most_sixteen_maps_per_layer(harness: Any) -> None:
    """40 VALs need ceil(40 / 16) frames, and every map of both layers is drawn exactly once."""
    _start(harness)
    harness.picture()
    vals = [harness.val([0.04 * i - 0.8, 2.0, 0.3], [0, -1, 0], 0.1, 2.0) for i in range(40)]
    harness.page.evaluate(
        """() => {
          window.tiles = []
          const viewport = WebGL2RenderingContext.prototype.viewport
          WebGL2RenderingContext.prototype.viewport = function (x, y, width, height) {
            if (width === 128 && height === 128) window.tiles.push(`${x},${y}`)
            return viewport.call(this, x, y, width, height)
          }
        }"""
    )
    harness.call("setLight", vals, [0.2] * 27)
    drawn = []
    for pending in (True, True, False, False):
        assert harness.call("render")["pending"] is pending
        drawn.append(harness.page.evaluate("window.tiles.splice(0)"))
    assert [len(each) for each in drawn] == [32, 32, 16, 0]
    places = [place for frame in drawn for place in frame]
    assert len(set(places)) == 40
    assert all(places.count(place) == 2 for place in set(places))
    finished = harness.picture()
    harness.call("setLight", vals, [0.2] * 27)
    np.testing.assert_array_equal(harness.picture(), finished)
