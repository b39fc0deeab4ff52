"""The command around the benchmark: parts, failures, resumption and exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import typer

from nearfield_server.benchmark import assembly
from nearfield_server.benchmark.parts import BenchSetup
from nearfield_server.commands import bench
from nearfield_server.errors import AssetError, ServiceError


def _fake_parts(monkeypatch: pytest.MonkeyPatch, ran: list[str]) -> None:
    def load(name: str) -> Any:
        def part(setup: BenchSetup) -> dict[str, Any]:
            ran.append(name)
            if name == "client":
                raise ServiceError("no browser")
            if name == "latency":
                raise ZeroDivisionError("a fault")
            return {"measured": name, "quick": setup.quick}

        return part

    monkeypatch.setattr(assembly, "load_part", load)


def test_parts_that_fail_are_told_and_the_others_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[str] = []
    _fake_parts(monkeypatch, ran)
    with pytest.raises(typer.Exit) as stopped:
        bench.bench(out=tmp_path / "new", quick=True)
    assert stopped.value.exit_code == 3
    report = json.loads((tmp_path / "new" / "bench.json").read_text(encoding="utf-8"))
    assert ran == ["server", "capture", "client", "methods", "ablation", "growth", "temporal", "latency"]
    assert report["server"] == {"measured": "server", "quick": True}
    assert report["client"] == {"missing": "no browser"}
    assert "ZeroDivisionError: a fault (test_bench.py:" in report["latency"]["missing"]
    assert report["parts"]["growth"]["state"] == "done"
    assert report["parts"]["client"]["state"] == "failed"
    assert report["versions"]["python"]
    assert report["machine"]["cpus"] >= 1


def test_one_part_leaves_the_others_as_they_were(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[str] = []
    _fake_parts(monkeypatch, ran)
    bench.bench(out=tmp_path, only=["server"])
    bench.bench(out=tmp_path, only=["growth"])
    report = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))
    assert report["server"]["measured"] == "server"
    assert report["growth"]["measured"] == "growth"
    assert report["methods"] == {"missing": "not part of this run"}


def test_resuming_runs_what_is_missing_failed_or_was_set_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[str] = []
    _fake_parts(monkeypatch, ran)
    with pytest.raises(typer.Exit):
        bench.bench(out=tmp_path, only=["server", "client"])
    ran.clear()
    with pytest.raises(typer.Exit):
        bench.bench(out=tmp_path, only=["server", "client", "growth"], resume=True)
    assert ran == ["client", "growth"]
    ran.clear()
    bench.bench(out=tmp_path, only=["server"], resume=True, quick=True)
    assert ran == ["server"]


def test_wrong_choices_are_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(typer.BadParameter, match="latency, found 'clinet'"):
        bench.bench(out=tmp_path, only=["clinet"])
    with pytest.raises(typer.BadParameter, match="auto, cpu or gl"):
        bench.bench(out=tmp_path, only=["server"], backend="cuda")


def test_a_broken_file_of_a_former_run_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "bench.json").write_text("{", encoding="utf-8")
    with pytest.raises(AssetError, match="cannot be read"):
        bench.bench(out=tmp_path, only=["server"])
    assert (tmp_path / "bench.json").read_text(encoding="utf-8") == "{"
