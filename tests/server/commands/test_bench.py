import json
from pathlib import Path

import numpy as np
import pytest

from nearfield_server.commands import bench
from nearfield_server.pipeline.runner import STAGES
from nearfield_server.records import LightSettings


def test_report_holds_every_stage_and_ratio() -> None:
    report = bench.measure(bench._box_scenario(48), LightSettings(num_samples=256), "cpu", 2)
    assert tuple(report["stages"]) == STAGES
    for row in report["stages"].values():
        assert row["cpu_ms"] >= 0.0
        assert row["copies"] == pytest.approx(row["cpu_ms"] / report["copy_67_mb"]["cpu_ms"])
    assert report["update"]["times_faster_than_numpy"] > 0.0
    assert report["backend"] == "cpu"
    assert report["unchanged_us"] > 0.0
    json.dumps(report)


def test_noise_gives_every_round_new_pictures() -> None:
    scenario = bench._box_scenario(48)
    first, second = bench._noisy_frames(scenario, 0), bench._noisy_frames(scenario, 1)
    assert not np.array_equal(first[0].pixels, second[0].pixels)
    assert np.isfinite(first[0].pixels).all()


def test_command_writes_its_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "_box_scenario", lambda size, make=bench._box_scenario: make(48))
    bench.bench(out=tmp_path / "new", room=None, rounds=1, backend="cpu", vals=8, ratio=0.9, quick=True)
    report = json.loads((tmp_path / "new" / "bench.json").read_text(encoding="utf-8"))
    assert report["scene"]["vals"] == 8
    assert report["scene"]["split_ratio"] == 0.9
