"""Account of what the light stages did and what they were spared, for the status page."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from nearfield_server.records import StageReport


@dataclass(slots=True)
class StageTotals:
    """One stage since the start: updates in which it ran in full, in part or not at all, and its CPU time, milliseconds."""

    full: int = 0
    part: int = 0
    skipped: int = 0
    spent_ms: float = 0.0
    saved_ms: float = 0.0

    def add(self, report: StageReport) -> None:
        """Count one update."""
        if not report.ran:
            self.skipped += 1
        elif report.part < 1.0:
            self.part += 1
        else:
            self.full += 1
        self.spent_ms += report.cpu_ms
        self.saved_ms += report.saved_ms


class WorkLedger:
    """Adds up stage reports, and remembers the last update in which anything ran.

    An update counts when pictures, or word that they still hold, had come; idle looks at the clock do not.

    Args:
        change_tolerances: per camera, the relative change of a pixel that capture leaves out; part of the error bound.
    """

    def __init__(self, change_tolerances: Iterable[float] = ()) -> None:
        self._tolerance = max(change_tolerances, default=0.0)
        self._totals: dict[str, StageTotals] = {}
        self._last: tuple[StageReport, ...] = ()
        self._last_s = 0.0

    def add(self, stages: tuple[StageReport, ...], now_s: float) -> None:
        """Count one update at `now_s` of any monotonic clock."""
        for report in stages:
            self._totals.setdefault(report.name, StageTotals()).add(report)
        if any(report.ran for report in stages):
            self._last, self._last_s = stages, now_s

    @property
    def error_bound(self) -> float:
        """Largest error of the light in use, relative to it, that leaving out work can have caused: capture's and the stages' together."""
        kept = 1.0 + self._tolerance
        for report in self._last:
            kept *= 1.0 + report.error_bound
        return kept - 1.0

    def report(self, now_s: float) -> dict[str, Any]:
        """Return the fields `stages` (the last update in which anything ran, and totals) and `skipping` of the status message.

        Any thread may ask. `age_s` is the time since that update, in which nothing had to be done; null before the first.
        """
        last, totals = self._last, list(self._totals.values())
        return {
            "stages": [self._stage(report) for report in last],
            "skipping": {
                "age_s": round(now_s - self._last_s, 3) if last else None,
                "saved_ms": round(sum(report.saved_ms for report in last), 3),
                "saved_total_ms": round(sum(stage.saved_ms for stage in totals), 1),
                "spent_total_ms": round(sum(stage.spent_ms for stage in totals), 1),
                "error_bound": self.error_bound,
            },
        }

    def _stage(self, report: StageReport) -> dict[str, Any]:
        totals = self._totals[report.name]
        return {
            "name": report.name,
            "ran": report.ran,
            "part": round(report.part, 4),
            "reason": report.reason,
            "wall_ms": round(report.wall_ms, 3),
            "cpu_ms": round(report.cpu_ms, 3),
            "saved_ms": round(report.saved_ms, 3),
            "error_bound": report.error_bound,
            "updates_full": totals.full,
            "updates_part": totals.part,
            "updates_skipped": totals.skipped,
            "spent_total_ms": round(totals.spent_ms, 1),
            "saved_total_ms": round(totals.saved_ms, 1),
        }
