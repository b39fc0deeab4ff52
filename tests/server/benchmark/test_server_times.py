import json

import numpy as np
import pytest

from nearfield_server.benchmark.scenario import box_scenario, noisy_frames
from nearfield_server.benchmark.server_times import measure
from nearfield_server.pipeline.runner import STAGES
from nearfield_server.records import LightSettings


def test_report_holds_every_stage_and_ratio() -> None:
    report = measure(box_scenario(96), LightSettings(num_samples=256), "cpu", 2)
    assert tuple(report["stages"]) == STAGES
    for row in report["stages"].values():
        assert row["cpu_ms"] >= 0.0
        assert row["copies"] == pytest.approx(row["cpu_ms"] / report["copy_67_mb"]["cpu_ms"])
    assert report["update"]["times_faster_than_numpy"] > 0.0
    assert report["backend"] == "cpu"
    assert report["unchanged_us"] > 0.0
    json.dumps(report)


def test_noise_gives_every_round_new_pictures() -> None:
    scenario = box_scenario(48)
    first, second = noisy_frames(scenario, 0), noisy_frames(scenario, 1)
    assert not np.array_equal(first[0].pixels, second[0].pixels)
    assert np.isfinite(first[0].pixels).all()
