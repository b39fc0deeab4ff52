"""The account adds up: every update of a stage is full, partial or skipped, and bounds of errors multiply."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.illumination.work_ledger import WorkLedger
from nearfield_server.records import StageReport


def report(name: str, part: float, saved_ms: float = 0.0, error_bound: float = 0.0) -> StageReport:
    return StageReport(
        name=name,
        ran=part > 0.0,
        reason="new pictures",
        wall_ms=part,
        cpu_ms=2.0 * part,
        part=part,
        saved_ms=saved_ms,
        error_bound=error_bound,
    )


@given(st.lists(st.sampled_from([0.0, 0.25, 1.0]), min_size=1, max_size=40))
def test_every_update_is_counted_once(parts: list[float]) -> None:
    ledger = WorkLedger()
    for part in parts:
        ledger.add((report("gather", part, saved_ms=1.0 - part), report("split", 1.0)), 3.0)
    found = ledger.report(5.5)
    gather, split = found["stages"]
    counted = [gather[f"updates_{kind}"] for kind in ("full", "part", "skipped")]
    assert counted == [parts.count(1.0), parts.count(0.25), parts.count(0.0)]
    assert gather["part"] == parts[-1]
    assert gather["ran"] == (parts[-1] > 0)
    assert split["updates_full"] == len(parts)
    assert gather["saved_total_ms"] == pytest.approx(sum(1.0 - part for part in parts), abs=0.06)
    totals = found["skipping"]
    assert totals["saved_ms"] == pytest.approx(1.0 - parts[-1])
    assert totals["spent_total_ms"] == pytest.approx(2.0 * (sum(parts) + len(parts)), abs=0.06)
    assert totals["error_bound"] == 0.0
    assert totals["age_s"] == 2.5


def test_the_last_update_that_did_anything_stays_in_sight() -> None:
    ledger = WorkLedger()
    ledger.add((report("gather", 1.0), report("probe", 0.0)), 1.0)
    for second in range(2, 9):
        ledger.add((report("gather", 0.0, saved_ms=10.0), report("probe", 0.0, saved_ms=2.0)), second)
    found = ledger.report(9.0)
    assert [stage["ran"] for stage in found["stages"]] == [True, False]
    assert [stage["updates_skipped"] for stage in found["stages"]] == [7, 8]
    assert (found["skipping"]["age_s"], found["skipping"]["saved_ms"]) == (8.0, 0.0)
    assert found["skipping"]["saved_total_ms"] == 7 * 12.0


def test_the_error_bound_holds_for_capture_and_stages_together() -> None:
    ledger = WorkLedger([0.0, 0.02])
    assert ledger.error_bound == pytest.approx(0.02)
    ledger.add((report("gather", 0.5, error_bound=0.01), report("sh", 1.0)), 0.0)
    assert ledger.report(0.0)["skipping"]["error_bound"] == pytest.approx(1.02 * 1.01 - 1.0)
    ledger.add((report("gather", 1.0), report("sh", 1.0)), 1.0)
    assert ledger.error_bound == pytest.approx(0.02)


def test_before_the_first_update_there_is_nothing_to_tell() -> None:
    found = WorkLedger().report(7.0)
    assert found["stages"] == []
    assert set(found["skipping"].values()) == {None, 0.0}
