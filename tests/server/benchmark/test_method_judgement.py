"""Light is judged at the bundle's points: it adds up, and nothing is judged where there is no truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nearfield_server.benchmark.method_judgement import irradiance_at_points, mean_of_views
from nearfield_server.benchmark.method_scene import MethodScene, load_method_scene
from nearfield_server.benchmark.methods import METHODS
from nearfield_server.benchmark.methods.light import MethodLight

TINY = Path(__file__).parents[2] / "data" / "tiny_room"


@pytest.fixture(scope="module")
def scene() -> MethodScene:
    return load_method_scene(TINY, num_noisy=0, max_views=1, backend="cpu", say=lambda text: None)


@pytest.fixture(scope="module")
def light(scene: MethodScene) -> MethodLight:
    return METHODS["nearfield"].make(scene.around, 8, scene.make_nearfield).extract(scene.clean)


def test_irradiance_is_proportional_to_the_light(scene: MethodScene, light: MethodLight) -> None:
    once, truth = irradiance_at_points(scene, light, scene.objects)
    vals = light.vals.copy()
    vals["radiant_intensity"] *= 2.0
    twice, same_truth = irradiance_at_points(
        scene, replace(light, vals=vals, object_sh=2 * light.object_sh), scene.objects
    )
    np.testing.assert_allclose(twice, 2.0 * once, rtol=1e-6)
    np.testing.assert_array_equal(truth, same_truth)
    assert once.shape == truth.shape


def test_a_room_that_hides_nothing_leaves_no_less_light(scene: MethodScene, light: MethodLight) -> None:
    hidden, _ = irradiance_at_points(scene, light, scene.objects)
    seen, _ = irradiance_at_points(scene, light, scene.objects, room_shadows=False)
    assert (seen >= hidden - 1e-9).all()


def test_without_points_there_is_nothing_to_judge(scene: MethodScene, light: MethodLight) -> None:
    bare = replace(scene, bundle=replace(scene.bundle, points=None))
    assert irradiance_at_points(bare, light, scene.objects) is None
    assert irradiance_at_points(scene, light, ()) is None


def test_means_are_over_the_views_that_have_the_figure() -> None:
    judged = [{"flip": 0.1}, {"flip": None}, {"flip": 0.3}]
    assert mean_of_views(judged, "flip") == pytest.approx(0.2)
    assert mean_of_views([{"flip": None}], "flip") is None
