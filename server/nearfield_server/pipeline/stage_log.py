"""What the stages of an update did: ran, skipped or ran in part, why, at what cost, and what that saved."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

from nearfield_server.records import StageReport

Clock = Callable[[], float]
_MEAN_OVER_RUNS: Final = 16
"""Whole runs of a stage that its mean cost remembers."""
_T = TypeVar("_T")


class _MeanCost:
    """Running mean of the CPU time of a stage's whole runs; old runs fade.

    The first run, which loads and compiles kernels, does not count.
    """

    def __init__(self) -> None:
        self.mean_ms = 0.0
        self._runs = -1

    def add(self, cpu_ms: float) -> None:
        """Count one whole run."""
        self._runs = min(self._runs + 1, _MEAN_OVER_RUNS)
        if self._runs > 0:
            self.mean_ms += (cpu_ms - self.mean_ms) / self._runs


class StageLog:
    """Times stages and collects the reports of one update. All skipping is exact, so that no report adds an error."""

    def __init__(self, stages: tuple[str, ...], wall_clock: Clock, cpu_clock: Clock) -> None:
        self._costs = {stage: _MeanCost() for stage in stages}
        self._wall_clock, self._cpu_clock = wall_clock, cpu_clock
        self._reports: dict[str, StageReport] = {}

    def start(self) -> None:
        """Begin a new update."""
        self._reports = {}

    def timed(
        self, name: str, reason: str, stage: Callable[[], _T], part: Callable[[_T], float] | None = None
    ) -> _T:
        """Run a stage and report it.

        Args:
            name: of the stage.
            reason: why it runs.
            stage: does the work.
            part: share of the whole work that led to the result; None: all of it.
        """
        wall, cpu = self._wall_clock(), self._cpu_clock()
        result = stage()
        wall_ms, cpu_ms = (self._wall_clock() - wall) * 1e3, (self._cpu_clock() - cpu) * 1e3
        share = 1.0 if part is None else part(result)
        cost = self._costs[name]
        if share >= 1.0:
            cost.add(cpu_ms)
        saved_ms = max(0.0, cost.mean_ms - cpu_ms) if share < 1.0 else 0.0
        self._reports[name] = StageReport(
            name=name,
            ran=True,
            reason=reason,
            wall_ms=wall_ms,
            cpu_ms=cpu_ms,
            part=share,
            saved_ms=saved_ms,
        )
        return result

    def skip(self, name: str, reason: str) -> None:
        """Report a stage that had nothing to do."""
        self._reports[name] = StageReport(
            name=name,
            ran=False,
            reason=reason,
            wall_ms=0.0,
            cpu_ms=0.0,
            part=0.0,
            saved_ms=self._costs[name].mean_ms,
        )

    def reports(self) -> tuple[StageReport, ...]:
        """All stages in order; those that nobody mentioned had no new input."""
        for name in self._costs:
            if name not in self._reports:
                self.skip(name, "unchanged")
        return tuple(self._reports[name] for name in self._costs)
