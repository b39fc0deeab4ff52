"""What is drawn when, edges, occlusion by real surfaces, and recovery."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.browser

WIDTH, HEIGHT = 160, 120
LIGHT = ([0.4, 2.0, 0.3], [0, -1, 0], 0.2, 6.0)


def _start(harness: Any, *, wall: bool = False) -> dict[str, Any]:
    view = harness.view([0, 1.0, 2.5], [0, 0.5, 0], WIDTH, HEIGHT, 150.0)
    room = harness.floor()
    if wall:
        room = harness.join(
            room, harness.box([-0.5, 0.0, 0.5], [0.0, 1.5, 0.6], [0.5, 0.5, 0.5], inward=False)
        )
    scene = {"room": room, "objects": [harness.sphere([0, 0.5, 0], 0.3)], "views": [view]}
    harness.create(scene, WIDTH, HEIGHT)
    harness.call("setLight", [harness.val(*LIGHT)], [0.2] * 27)
    return view


def _ran(harness: Any) -> set[str]:
    return {each["name"] for each in harness.call("render")["passes"] if each["ran"]}


def test_nothing_changed_means_nothing_drawn(harness: Any) -> None:
    _start(harness)
    assert {"shadow maps", "gbuffer", "tiles", "shade", "resolve", "display"} <= _ran(harness)
    assert _ran(harness) == set()


def test_only_what_depends_on_a_change_is_drawn(harness: Any) -> None:
    _start(harness)
    _ran(harness)
    harness.call("setOptions", {"exposure": 2.0})
    assert _ran(harness) == {"display"}
    harness.call("setOptions", {"indirectOcclusion": False})
    assert _ran(harness) == {"shade", "resolve", "display"}
    pose = np.eye(4)
    pose[:3, 3] = [0.1, 0.5, 0]
    harness.call("setPose", 0, pose.ravel().tolist())
    moved = _ran(harness)
    assert {"shadow maps", "gbuffer", "tiles", "shade", "coverage"} <= moved
    assert "background" not in moved
    harness.call("setPose", 0, pose.ravel().tolist())
    assert _ran(harness) == set()


def test_a_new_camera_picture_alone_is_put_behind_what_is_there(harness: Any) -> None:
    view = harness.view([0, 1.0, 2.5], [0, 0.5, 0], WIDTH, HEIGHT, 150.0)
    view["background"] = np.full(3 * WIDTH * HEIGHT, 2.0).tolist()
    scene = {"room": harness.floor(), "objects": [harness.sphere([0, 0.5, 0], 0.3)], "views": [view]}
    pictures = []
    for starts_dim in (False, True):
        harness.create(scene, WIDTH, HEIGHT)
        harness.call("setLight", [harness.val(*LIGHT)], [0.2] * 27)
        if not starts_dim:
            _ran(harness)
        harness.call("setWeights", [0.5, 1.0, 1.0])
        ran = _ran(harness)
        assert starts_dim or ran == {"background", "display"}
        pictures.append(harness.picture())
    np.testing.assert_array_equal(*pictures)


def test_live_frames_keep_to_their_budget_of_shadow_maps(harness: Any) -> None:
    _start(harness)
    place, normal, radius, radiance = LIGHT
    vals = [harness.val([0.05 * i, *place[1:]], normal, radius, radiance) for i in range(40)]
    harness.call("setLight", vals, [0.2] * 27)
    pending = [harness.call("render")["pending"] for _ in range(3)]
    assert pending == [True, True, False]
    harness.call("setOptions", {"fullQuality": True})
    assert harness.call("render")["pending"] is False


def test_coverage_of_a_sphere_is_its_solid_outline(harness: Any) -> None:
    """Summed coverage equals the area of the outline: an ellipse that the tangent cone cuts from the picture plane."""
    view = _start(harness)
    picture = harness.picture()
    pose = np.reshape(view["worldFromCamera"], (4, 4))
    distance = np.linalg.norm(pose[:3, 3] - [0, 0.5, 0])
    tangent = np.tan(np.arcsin(0.3 / distance))
    area = np.pi * (tangent * view["fx"]) ** 2
    assert picture[..., 3].sum() == pytest.approx(area, rel=5e-3)
    edge = (picture[..., 3] > 0) & (picture[..., 3] < 1)
    assert edge.sum() > 50


def test_real_surfaces_hide_virtual_ones(harness: Any) -> None:
    _start(harness)
    free = harness.picture()[..., 3]
    _start(harness, wall=True)
    hidden = harness.picture()[..., 3]
    assert hidden[:, : WIDTH // 2 - 2].max() == 0
    np.testing.assert_array_equal(hidden[:, WIDTH // 2 + 8 :], free[:, WIDTH // 2 + 8 :])


def test_a_lost_context_comes_back_with_the_same_picture(harness: Any) -> None:
    _start(harness)
    before = harness.picture()
    harness.call("loseContext")
    np.testing.assert_array_equal(harness.picture(), before)


def test_picking_finds_what_the_picture_shows(harness: Any) -> None:
    _start(harness)
    assert harness.call("pick", 0, 0)["objectIndex"] == 0
    floor = harness.call("pick", 0, -0.9)
    assert floor["objectIndex"] == -1
    assert floor["position"][1] == pytest.approx(0, abs=1e-6)
    assert harness.call("pick", 0, 0.95) is None


def test_the_canvas_shows_the_composite_in_srgb(harness: Any) -> None:
    view = _start(harness)
    view["background"] = np.tile([0.0, 0.1, 0.5], WIDTH * HEIGHT).tolist()
    scene = {"room": harness.floor(), "objects": [], "views": [view]}
    harness.create(scene, WIDTH, HEIGHT, exposure=2.0, softClip=False)
    colour = harness.page.evaluate(
        """() => {
          harness.render()
          const canvas = document.querySelector('canvas')
          const copy = new OffscreenCanvas(1, 1).getContext('2d')
          copy.drawImage(canvas, -80, -60)
          return [...copy.getImageData(0, 0, 1, 1).data]
        }"""
    )
    linear = np.array([0.0, 0.2, 1.0])
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(colour[:3], 255 * srgb, atol=1)


def test_a_scene_with_too_many_objects_is_refused_in_words(harness: Any) -> None:
    scene = {
        "room": harness.floor(),
        "objects": [harness.sphere([0, 1, 0], 0.1, rings=3)] * 17,
        "views": [harness.view([0, 1, 2], [0, 1, 0], 8, 8, 8.0)],
    }
    with pytest.raises(Exception, match=r"17 virtual objects.*at most 16"):
        harness.call("create", scene, {})
