"""`nearfield evaluate`: judges the whole system by a bundle with known truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from nearfield_server.evaluation.evaluate import evaluate_bundle


def evaluate(
    bundle: Annotated[Path, typer.Argument(help="Bundle folder, or its scene.json.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for report.json, index.html and pictures.")],
    vals: Annotated[int, typer.Option(help="Slots for virtual area lights, 1 to 64.")] = 16,
    ratio: Annotated[
        float | None,
        typer.Option(
            help="Share of the light that becomes direct, in (0, 1]; default: chosen from the atlas."
        ),
    ] = None,
    lighting: Annotated[str, typer.Option(help="nominal, or SEQUENCE:FRAME of the bundle.")] = "nominal",
    preset: Annotated[
        str, typer.Option(help="Quality of prepared models: preview, medium or high.")
    ] = "medium",
    views: Annotated[bool, typer.Option(help="Render the tablet views with the real client.")] = True,
) -> None:
    """Measure errors, bytes and times against path-traced truth, and write a report with pictures."""
    console = Console(stderr=True)
    with console.status("starting") as status:
        report = evaluate_bundle(
            bundle,
            out,
            num_vals=vals,
            split_ratio=ratio,
            lighting=lighting,
            preset=preset,
            with_views=views,
            progress=lambda text: status.update(text),
        )
    console.print(summary(report))
    console.print(f"report: {out / 'index.html'}", highlight=False)


def summary(report: dict[str, Any]) -> Table:
    """The main numbers as a table."""
    table = Table(show_header=False, box=None)
    for name in ("irradiance", "atlas"):
        for key, value in (report[name] or {}).items():
            table.add_row(name, key, f"{value:.4f}")
    for view in report["views"]:
        for key in ("object_rel_rmse", "shadow_rel_rmse", "flip_mean", "ssim"):
            table.add_row(f"view {view['id']}", key, "-" if view[key] is None else f"{view[key]:.4f}")
    table.add_row("packet", "bytes", str(report["packet_bytes"]))
    table.add_row("update", "ms", f"{report['stage_ms']['update']:.1f}")
    table.add_row("unchanged update", "ms", f"{report['stage_ms']['skipped_update']:.4f}")
    return table
