"""What a picture costs: every step runs on real pictures, and the errors beside the times are those of the pictures that were timed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nearfield_server.benchmark.capture_times import BRACKET, _Bench, _scene, measure_capture
from nearfield_server.errors import ConfigError
from nearfield_server.scene.exr import write_exr

TINY = Path(__file__).parents[2] / "data" / "tiny_room"


def test_every_step_has_a_cost_an_error_and_a_size() -> None:
    section = measure_capture(TINY, 2)
    assert set(section["to_copy"]) - {"spread"} == set(section["cpu_ms"]) - {"copy"}
    assert section["raw_bits_changed"] == 0
    sizes = section["bytes_per_pixel"]
    assert (sizes["wire"], sizes["ring"]) == (1.5, 8.0)
    assert sizes["exr"] < sizes["raw"] < sizes["ring"]
    assert 0.0 < section["errors"]["merge"]["median"] < 0.02
    assert section["errors"]["merge"]["share"] > 0.8


def test_the_scene_spans_more_than_the_five_orders_that_are_judged() -> None:
    truth, inside = _scene(TINY)
    assert truth[inside].max() / truth[inside].min() > 1e5
    bench = _Bench(truth, inside)
    # Neither the shortest exposure is full anywhere, nor the longest without light anywhere.
    assert truth.max() * bench.amounts[-1] < 1.0
    assert bench.amounts[0] / bench.amounts[-1] == pytest.approx(BRACKET[0] / BRACKET[-1])
    assert bench.errors()["merge"]["share"] > bench.errors()["single"]["share"]


def test_changed_bits_are_counted() -> None:
    bench = _Bench(*_scene(TINY))
    for action in bench.actions.values():
        action()
    assert bench.raw_bits_changed() == 0
    bench.unpacked[3, 4, 1] = -bench.unpacked[3, 4, 1]
    assert bench.raw_bits_changed() == 1


def test_a_room_of_other_cameras_is_refused_in_words(tmp_path: Path) -> None:
    write_exr(tmp_path / "0000.exr", np.ones((8, 8, 3), np.float16))
    (tmp_path / "room.toml").write_text(
        f'''format = 1
name = "other"
model = "{TINY / "room.glb"}"
[[cameras]]
id = "a"
width = 8
height = 8
fx = 4.0
fy = 4.0
cx = 3.5
cy = 3.5
theta_max = 1.5
world_from_camera = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]
source = {{ kind = "exr_sequence", folder = "{tmp_path}" }}
'''
    )
    with pytest.raises(ConfigError, match="camera a is of kind exr_sequence"):
        measure_capture(tmp_path, 1)
