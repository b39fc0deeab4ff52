"""The page that draws the methods: light adds up, and parts of the renderer can be left out."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from nearfield_server.benchmark import method_packets
from nearfield_server.benchmark.method_scene import MethodScene, load_method_scene
from nearfield_server.benchmark.method_views import MethodViews, open_views
from nearfield_server.benchmark.methods import METHODS
from nearfield_server.benchmark.methods.light import ClientForm, MethodLight
from nearfield_server.benchmark.transfer_forms import room_with_models

TINY = Path(__file__).parents[2] / "data" / "tiny_room"
PAPER = METHODS["vpl"].form

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MethodScene]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NEARFIELD_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield load_method_scene(TINY, num_noisy=1, max_views=1, backend="cpu", say=lambda text: None)


@pytest.fixture(scope="module")
def views(scene: MethodScene, tmp_path_factory: pytest.TempPathFactory) -> Iterator[MethodViews]:
    room = room_with_models(scene.room, "shadowed", tmp_path_factory.mktemp("models"))
    with open_views(room, scene.mesh, len(scene.texels.texel_index), lambda text: None) as opened:
        yield opened


def _light(scene: MethodScene, name: str, lights: int) -> MethodLight:
    return METHODS[name].make(scene.around, lights, scene.make_nearfield).extract(scene.clean)


def _draw(views: MethodViews, light: MethodLight, form: ClientForm) -> np.ndarray:
    views.use(form)
    return views.composite(0, light, full_quality=True)


def test_lights_drawn_in_turns_add_up_to_all_at_once(
    scene: MethodScene, views: MethodViews, monkeypatch: pytest.MonkeyPatch
) -> None:
    light = _light(scene, "vpl_split", 8)
    together = _draw(views, light, PAPER)
    monkeypatch.setattr(method_packets, "MAX_LIGHTS", 3)
    in_turns = _draw(views, light, PAPER)
    np.testing.assert_allclose(in_turns, together, atol=2e-3 * together.max())


def test_without_lights_real_surfaces_are_the_background_averaged(
    scene: MethodScene, views: MethodViews
) -> None:
    drawn = _draw(views, _light(scene, "prt_only", 0), PAPER)
    truth = scene.views[0][1]
    real = truth.coverage == 0.0
    np.testing.assert_allclose(drawn[real], truth.composite_background[real], rtol=2e-3, atol=1e-4)


def test_the_receiver_ratio_darkens_surfaces_near_the_object_and_no_others(
    scene: MethodScene, views: MethodViews
) -> None:
    light = _light(scene, "gierlinger", 0)
    plain, ratio = _draw(views, light, PAPER), _draw(views, light, METHODS["gierlinger"].form)
    assert (ratio <= plain + 1e-6).all()
    real = scene.views[0][1].coverage == 0.0
    darkened = real & (ratio.sum(axis=2) < 0.9 * plain.sum(axis=2))
    assert 0.005 < darkened.mean() < 0.5
    # Objects themselves are not receivers.
    inside = scene.views[0][1].coverage == 1.0
    np.testing.assert_array_equal(ratio[inside], plain[inside])


def test_a_room_that_hides_nothing_lets_far_lights_in(scene: MethodScene, views: MethodViews) -> None:
    light = _light(scene, "webxr", 1)
    inside = scene.views[0][1].coverage == 1.0
    form = ClientForm(transfer="shadowed", room_shadows=False)
    open_room, closed = _draw(views, light, form), _draw(views, light, PAPER)
    assert open_room[inside].mean() > 1.05 * closed[inside].mean()


def test_a_frame_costs_time_of_the_process_that_draws(scene: MethodScene, views: MethodViews) -> None:
    views.use(PAPER)
    assert views.frame_cpu_ms(0, [_light(scene, "vpl", 8)]) > 0.0
