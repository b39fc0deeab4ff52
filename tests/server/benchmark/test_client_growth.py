"""Cost against growth: the forms that the scene takes, and the gateway's clients."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nearfield_server.benchmark.client_growth import Point, measure_frames, measure_gateway
from nearfield_server.benchmark.client_scene import ClientScene
from nearfield_server.benchmark.client_times import Plan


def test_gateway_cost_is_a_curve_over_clients(tiny_scene: ClientScene) -> None:
    said: list[str] = []
    curve = measure_gateway(tiny_scene, 4, (1, 3), 5, said.append)
    assert curve["x"] == [1, 3]
    assert min(curve["cpu_ms"]) > 0.0
    assert np.isfinite(curve["exponent"])
    assert len(said) == 2


@pytest.mark.browser
def test_the_scene_grows_as_asked(tiny_scene: ClientScene, built_page: Path) -> None:
    points = {
        "object_triangles": {level: Point(slots=2, growth={"subdivisions": level}) for level in (0, 1)},
        "virtual_objects": {number: Point(slots=2, growth={"objects": number}) for number in (1, 3)},
    }
    plan = Plan(rounds=1, frames=1, width=96, height=54)
    curves = measure_frames(tiny_scene, points, plan, lambda _: None, static_dir=built_page)
    # The ball has 320 triangles; a subdivision makes four of one.
    assert curves["object_triangles"]["x"] == [320, 1280]
    assert curves["virtual_objects"]["x"] == [1, 3]
    for curve in curves.values():
        assert min(curve["cpu_ms"]) > 0.0
        assert np.isfinite(curve["exponent"])
