"""The whole benchmark command in its smallest form: every part but the latency runs, and everything is written. No figure is judged."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from nearfield_server.benchmark.methods import METHODS
from nearfield_server.benchmark.summary import METHOD_FIGURES
from nearfield_server.commands.bench import bench

# How late the light is can be measured on a machine with nothing else to do only; it has tests of its own.
PARTS = ("server", "capture", "client", "methods", "ablation", "growth", "temporal")
TINY = Path(__file__).parents[1] / "data" / "tiny_room"


@pytest.mark.browser
@pytest.mark.timeout(1200)
def test_one_command_measures_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NEARFIELD_CACHE_DIR", str(tmp_path / "cache"))
    bench(out=tmp_path / "out", bundles=[TINY], only=list(PARTS), tiny=True, lab=False)
    report = json.loads((tmp_path / "out" / "bench.json").read_text(encoding="utf-8"))
    assert {name: report["parts"][name]["state"] for name in PARTS} == dict.fromkeys(PARTS, "done")
    assert {row["name"] for row in report["methods"]} == set(METHODS)
    for row in report["methods"]:
        assert all(row[figure] >= 0.0 for figure in METHOD_FIGURES)
    assert report["server"]["stage_cpu_ms"]["gather"] > 0.0
    assert report["capture"]["raw_bits_changed"] == 0
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "Run time against error" in page
    assert (tmp_path / "out" / "plots" / "tiny_error_against_time.svg").is_file()
