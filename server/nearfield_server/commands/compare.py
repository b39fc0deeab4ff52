"""`nearfield compare`: two benchmark runs side by side, for use between branches."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from nearfield_server.benchmark.compare import compare_runs, only_in_one
from nearfield_server.benchmark.summary import number
from nearfield_server.errors import AssetError


def compare(
    before: Annotated[Path, typer.Argument(help="bench.json of the first run, or its folder.")],
    after: Annotated[Path, typer.Argument(help="bench.json of the second run, or its folder.")],
    changed: Annotated[
        bool, typer.Option("--changed", help="Only what changed by more than its spread.")
    ] = False,
) -> None:
    """Show every figure of both runs, the ratio second / first, and mark what changed by more than its spread."""
    console = Console(width=None)
    old, new = read_run(before), read_run(after)
    rows = compare_runs(old, new)
    table = Table(box=None)
    for heading in ("figure", "first", "second", "ratio", "spread", ""):
        table.add_column(heading, justify="left" if heading in ("figure", "") else "right")
    for row in rows:
        if row.changed or not changed:
            mark = ("lower" if row.after < row.before else "higher") if row.changed else ""
            table.add_row(
                row.name,
                number(row.before),
                number(row.after),
                number(row.ratio),
                f"{100.0 * row.spread:.1f} %",
                mark,
            )
    console.print(table)
    console.print(
        f"{sum(row.changed for row in rows)} of {len(rows)} figures changed by more than their spread"
    )
    for words, names in zip(("first", "second"), only_in_one(old, new), strict=True):
        if names:
            console.print(f"only in the {words} run: {', '.join(names)}", highlight=False)
    if old["machine"].get("processor") != new["machine"].get("processor"):
        console.print(
            "the runs were made on different processors: times do not compare, ratios within a run do"
        )


def read_run(path: Path) -> dict[str, Any]:
    """Content of a bench.json.

    Raises:
        AssetError: there is none, or it is none.
    """
    file = path / "bench.json" if path.is_dir() else path
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise AssetError(
            f"{file}: cannot be read as a benchmark run ({error}); make one with `nearfield bench --out DIR`"
        ) from error
    if not isinstance(content, dict) or "machine" not in content:
        raise AssetError(f"{file}: expected the bench.json of `nearfield bench`, found something else")
    return content
