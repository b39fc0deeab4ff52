"""The main figures of bench.json for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.table import Table

from nearfield_server.benchmark.methods import METHODS

METHOD_FIGURES = (
    "irradiance_rel_rmse",
    "object_rel_rmse",
    "shadow_rel_rmse",
    "flip",
    "flicker",
    "server_ms",
    "client_ms",
    "bytes",
)
_HEADS = {
    "irradiance_rel_rmse": "irradiance error",
    "object_rel_rmse": "object error",
    "shadow_rel_rmse": "shadow error",
    "flip": "FLIP",
    "flicker": "flicker, 1/255",
    "server_ms": "server, CPU ms",
    "client_ms": "client, CPU ms",
    "bytes": "bytes",
}


def summary(report: dict[str, Any]) -> Table:
    """Ratios of server and client, and one line per method and light count."""
    table = Table(show_header=False, box=None)
    for section in ("server", "client"):
        for name, value in report[section].items():
            if isinstance(value, int | float):
                table.add_row(section, name, f"{value:.4g}")
            elif name == "missing":
                table.add_row(section, "missing", str(value))
    rows = report["methods"]
    if isinstance(rows, list):
        for row in rows:
            figures = (f"{name} {number(row[name])}" for name in METHOD_FIGURES)
            table.add_row(row["bundle"], f"{row['name']} {row['lights']}", ", ".join(figures))
    return table


def markdown_table(rows: Sequence[dict[str, Any]], lights: int = 16) -> str:
    """Every method of every bundle in one table, at the number of lights asked for where a method has a choice."""
    heads = ("bundle", "method", "lights", *(_HEADS[name] for name in METHOD_FIGURES))
    lines = ["| " + " | ".join(heads) + " |", "|---|---|" + "---:|" * (len(heads) - 2)]
    for row in rows:
        entry = METHODS[row["name"]]
        if len(entry.light_counts) == 1 or row["lights"] == lights:
            name = entry.title if entry.source else f"**{entry.title}**"
            figures = (number(row[figure]) for figure in METHOD_FIGURES)
            lines.append("| " + " | ".join((row["bundle"], name, str(row["lights"]), *figures)) + " |")
    return "\n".join(lines) + "\n"


def number(value: float | None) -> str:
    """A figure in four digits; a dash where there is none."""
    return "-" if value is None else f"{value:.4g}"
