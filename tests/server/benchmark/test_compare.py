from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import pytest

from nearfield_server.benchmark.compare import (
    DEFAULT_SPREAD,
    EXACT_SPREAD,
    compare_runs,
    figures,
    only_in_one,
)

MakeRun = Callable[[], dict[str, Any]]


def test_a_run_equals_itself(made_up_run: MakeRun) -> None:
    rows = compare_runs(made_up_run(), made_up_run())
    assert len(rows) > 100
    assert not any(row.changed for row in rows)
    # There is no ratio of figures that are 0: of bits that a recording lost, for one.
    assert all(row.ratio == 1.0 or (row.before, row.after) == (0.0, 0.0) for row in rows)


def test_what_changed_by_more_than_its_spread_is_marked(made_up_run: MakeRun) -> None:
    before, after = made_up_run(), made_up_run()
    after["client"]["frame_over_three16"] = 0.54  # told spread: 10 %
    after["client"]["rasterisers"]["llvmpipe"]["frame_over_three16"] = 0.56
    after["server"]["update_over_copy"] = 4.0
    after["capture"]["to_copy"]["record_raw"] = 7.5  # within its quartiles
    after["capture"]["cpu_ms"]["record_raw"] = 8.0
    for row in after["methods"]:
        if (row["name"], row["lights"]) == ("vpl", 8):
            row["flip"] = 0.1 * (1.0 + 2.0 * EXACT_SPREAD)
            row["server_ms"] = 20.0 * (1.0 + 0.5 * DEFAULT_SPREAD)
    changed = {row.name: row for row in compare_runs(before, after) if row.changed}
    assert set(changed) == {
        "capture.cpu_ms.record_raw",
        "client.rasterisers.llvmpipe.frame_over_three16",
        "server.update_over_copy",
        "methods.room <1>.vpl.8.flip",
    }
    assert changed["server.update_over_copy"].ratio == pytest.approx(0.8)


def test_figures_of_one_run_alone_are_named(made_up_run: MakeRun) -> None:
    before, after = made_up_run(), made_up_run()
    after["methods"] = copy.deepcopy(after["methods"][1:])
    after["latency"] = {"p50_ms": 40.0}
    gone, new = only_in_one(before, after)
    assert new == ["latency.p50_ms"]
    assert len(gone) == 8
    assert all(name.startswith("methods.room <1>.nearfield.8.") for name in gone)


def test_missing_parts_have_no_figures(made_up_run: MakeRun) -> None:
    run = made_up_run()
    run["methods"] = {"missing": "no browser"}
    assert not any(name.startswith("methods") for name, _ in figures(run))


def test_a_figure_that_was_zero_has_no_ratio(made_up_run: MakeRun) -> None:
    before, after = made_up_run(), made_up_run()
    before["server"]["update_over_copy"] = 0.0
    row = next(row for row in compare_runs(before, after) if row.name == "server.update_over_copy")
    assert row.ratio is None
    assert row.changed
