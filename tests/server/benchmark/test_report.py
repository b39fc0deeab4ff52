from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from nearfield_server.benchmark.methods import METHODS
from nearfield_server.benchmark.report import draw_plots, write_page
from nearfield_server.errors import AssetError

MakeRun = Callable[[], dict[str, Any]]


def test_the_page_holds_every_method_plot_and_reason_and_needs_no_other_file(
    tmp_path: Path, made_up_run: MakeRun
) -> None:
    run = made_up_run()
    (tmp_path / "methods").mkdir()
    (tmp_path / "methods" / "room <1>_nearfield_16.jpg").write_bytes(b"picture")
    text = write_page(tmp_path, run).read_text(encoding="utf-8")
    for entry in METHODS.values():
        assert entry.title.replace("&", "&amp;") in text
    assert "room &lt;1&gt;" in text
    assert "no browser &lt;here&gt;" in text
    assert "project four cameras, combine" in text
    assert "<td>record raw</td><td>7</td><td>7</td>" in text
    assert text.count("<svg") == len(draw_plots(run)) == 6
    assert 'src="data:image/jpeg;base64,cGljdHVyZQ=="' in text
    assert 'src="http' not in text


def test_plots_are_files_of_their_own_with_the_methods_names_as_text(
    tmp_path: Path, made_up_run: MakeRun
) -> None:
    write_page(tmp_path, made_up_run())
    files = sorted((tmp_path / "plots").iterdir())
    assert [file.name for file in files] == [
        "fig11_objects.svg",
        "fig12_screen.svg",
        "room__1__error_against_bytes.svg",
        "room__1__error_against_time.svg",
        "room__1__fig10_error_by_lights.svg",
        "room__1__flicker.svg",
    ]
    for file in files:
        ElementTree.parse(file)
    assert "Split + cluster" in files[3].read_text(encoding="utf-8")
    assert "exponent 1.00" in files[0].read_text(encoding="utf-8")


def test_the_table_for_documents_has_each_method_once_per_bundle(
    tmp_path: Path, made_up_run: MakeRun
) -> None:
    write_page(tmp_path, made_up_run())
    lines = (tmp_path / "methods.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 2 + len(METHODS)
    assert len({line.count("|") for line in lines}) == 1
    assert lines[2].startswith("| room <1> | **Nearfield** | 16 | 0.02353 |")


def test_a_run_without_any_part_still_has_a_page(tmp_path: Path, made_up_run: MakeRun) -> None:
    run = made_up_run()
    for part in ("server", "capture", "client", "methods", "ablation", "growth", "temporal", "latency"):
        run[part] = {"missing": f"{part} was not run"}
    text = write_page(tmp_path, run).read_text(encoding="utf-8")
    assert text.count("was not run") == 8
    assert draw_plots(run) == {}


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path, made_up_run: MakeRun) -> None:
    (tmp_path / "plots").write_text("a file")
    with pytest.raises(AssetError, match="--out"):
        write_page(tmp_path, made_up_run())
