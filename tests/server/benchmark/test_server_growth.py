"""Cost of an update against the size of everything."""

from __future__ import annotations

import json

import numpy as np
import pytest

from nearfield_server.benchmark.server_growth import Form, growth_forms, measure_server_growth


@pytest.mark.parametrize(
    "name", ["atlas_texels", "camera_pixels", "cameras", "server_vals", "server_objects"]
)
def test_one_thing_grows_at_a_time(name: str) -> None:
    forms = growth_forms(64)[name]
    base = Form(atlas_size=64, camera_size=64)
    changed = {
        field
        for form in forms
        for field in ("atlas_size", "camera_size", "cameras", "objects", "vals")
        if getattr(form, field) != getattr(base, field)
    }

    (field,) = changed
    sizes = [getattr(form, field) for form in forms]
    assert sizes == sorted(set(sizes))


def test_form_is_what_the_room_has() -> None:
    scenario = Form(atlas_size=24, camera_size=16, cameras=2, objects=5).scenario()
    assert scenario.texels.width == 24
    assert scenario.table.camera_shapes == ((16, 16), (16, 16))
    assert len(scenario.pictures) == 2
    assert len(scenario.objects) == 5


def test_every_direction_gives_a_curve() -> None:
    report = measure_server_growth("cpu", False, lambda _: None, tiny=True)
    json.dumps(report)
    for name, curve in report.items():
        assert len(curve["x"]) == len(curve["cpu_ms"]) == len(growth_forms(48)[name])
        assert min(curve["cpu_ms"]) > 0.0
        assert np.isfinite(curve["exponent"])
    assert report["cameras"]["x"] == [1, 2, 4]
