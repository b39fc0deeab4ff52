from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nearfield_server.commands.compare import compare
from nearfield_server.errors import AssetError

MakeRun = Callable[[], dict[str, Any]]


def test_two_runs_are_shown_side_by_side(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], made_up_run: MakeRun
) -> None:
    first, second = made_up_run(), made_up_run()
    second["server"]["update_over_copy"] = 2.5
    for name, run in (("a", first), ("b", second)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "bench.json").write_text(json.dumps(run), encoding="utf-8")
    compare(tmp_path / "a", tmp_path / "b" / "bench.json", changed=True)
    said = capsys.readouterr().out
    assert "server.update_over_copy" in said
    assert "lower" in said
    assert "0.5" in said
    assert "1 of " in said
    assert "client" not in said


def test_what_is_no_run_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "bench.json").write_text("[]", encoding="utf-8")
    with pytest.raises(AssetError, match=r"expected the bench\.json"):
        compare(tmp_path, tmp_path)
    with pytest.raises(AssetError, match="nearfield bench --out"):
        compare(tmp_path / "none", tmp_path)
