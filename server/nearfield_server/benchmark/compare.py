"""Two runs side by side as ratios, with what changed by more than the runs themselves vary."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from nearfield_server.benchmark.parts import PARTS
from nearfield_server.benchmark.summary import METHOD_FIGURES

DEFAULT_SPREAD: Final = 0.1
"""Relative, for a figure whose run tells no spread: CPU times of one machine agree about that well from run to run."""
EXACT: Final = frozenset(
    {
        "irradiance_rel_rmse",
        "object_rel_rmse",
        "shadow_rel_rmse",
        "flip",
        "bytes",
        "val_movement_mm",
        "flicker",
    }
)
"""Figures that no clock takes part in: equal code gives equal values, so small changes count."""
EXACT_SPREAD: Final = 0.005
_SKIPPED: Final = frozenset({"rounds", "first_update_ms", "count"})

_NAMES: Final = ("scene", "name", "lamp")
"""What tells entries of a list apart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One figure of both runs.

    Attributes:
        name: where it is in bench.json. before, after: its values. spread: relative half width within which it is taken as unchanged.
    """

    name: str
    before: float
    after: float
    spread: float

    @property
    def ratio(self) -> float | None:
        """After / before, None where before is 0."""
        return self.after / self.before if self.before != 0.0 else None

    @property
    def changed(self) -> bool:
        """Whether the change is larger than the spread."""
        return abs(self.after - self.before) > self.spread * abs(self.before)


def compare_runs(before: dict[str, Any], after: dict[str, Any]) -> list[Comparison]:
    """All figures that both runs have, in the order of the first.

    Args:
        before: content of a bench.json.
        after: of another.
    """
    old, new = dict(figures(before)), dict(figures(after))
    spreads = _spreads(before), _spreads(after)
    return [
        Comparison(
            name=name,
            before=value,
            after=new[name],
            spread=_spread_of(name, spreads[0].get(name), spreads[1].get(name)),
        )
        for name, value in old.items()
        if name in new
    ]


def only_in_one(before: dict[str, Any], after: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Names of figures that only the first, and only the second run has."""
    old, new = dict(figures(before)), dict(figures(after))
    return [name for name in old if name not in new], [name for name in new if name not in old]


def figures(report: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Every figure of a run by name: `server.gather...`, `methods.<bundle>.<method>.<lights>.<figure>`."""
    for section in PARTS:
        if section != "methods":
            yield from _numbers(section, report.get(section, {}))
    rows = report.get("methods")
    for row in rows if isinstance(rows, list) else []:
        for key in METHOD_FIGURES:
            if row[key] is not None:
                yield f"methods.{row['bundle']}.{row['name']}.{row['lights']}.{key}", float(row[key])


def _numbers(prefix: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, bool):
        return
    if isinstance(value, int | float):
        yield prefix, float(value)
    elif isinstance(value, dict):
        for key, part in value.items():
            if key not in _SKIPPED and key not in ("scene", "machine", "spread"):
                yield from _numbers(f"{prefix}.{key}", part)
    elif isinstance(value, list):
        for number, part in enumerate(value):
            if isinstance(part, dict):
                name = next((str(part[key]) for key in _NAMES if key in part), str(number))
                yield from _numbers(f"{prefix}.{name}", part)


def _spreads(report: dict[str, Any]) -> dict[str, float]:
    """Relative half widths between quartiles of the ratios that tell them, by the name of the figure."""
    found: dict[str, float] = {}
    for section in ("server", "capture", "client"):
        _collect(report.get(section, {}), section, found)
    return found


def _collect(value: Any, prefix: str, found: dict[str, float]) -> None:
    if not isinstance(value, dict):
        return
    spreads = value.get("spread")
    if isinstance(spreads, dict):
        for key, entry in spreads.items():
            if isinstance(entry, dict) and entry.get("median"):
                width = abs(entry["upper_quartile"] - entry["lower_quartile"])
                found[f"{prefix}.{key}"] = 0.5 * width / abs(entry["median"])
    for key, part in value.items():
        if key != "spread":
            _collect(part, f"{prefix}.{key}", found)


def _spread_of(name: str, before: float | None, after: float | None) -> float:
    told = [value for value in (before, after) if value is not None]
    if told:
        return max(told)
    return EXACT_SPREAD if name.rsplit(".", 1)[-1] in EXACT else DEFAULT_SPREAD
