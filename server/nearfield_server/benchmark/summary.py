"""The main figures of bench.json for the terminal."""

from __future__ import annotations

from typing import Any

from rich.table import Table

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


def number(value: float | None) -> str:
    """A figure in four digits; a dash where there is none."""
    return "-" if value is None else f"{value:.4g}"
