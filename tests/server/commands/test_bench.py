import json
from pathlib import Path

import pytest

from nearfield_server.benchmark.scenario import box_scenario
from nearfield_server.commands import bench


def test_command_writes_its_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "box_scenario", lambda size: box_scenario(48))
    bench.bench(out=tmp_path / "new", room=None, rounds=1, backend="cpu", vals=8, ratio=0.9, quick=True)
    report = json.loads((tmp_path / "new" / "bench.json").read_text(encoding="utf-8"))
    assert report["scene"]["vals"] == 8
    assert report["scene"]["split_ratio"] == 0.9
