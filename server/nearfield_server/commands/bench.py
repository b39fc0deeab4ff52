"""`nearfield bench`: what every stage of the light pipeline costs, next to plain numpy and to memory bandwidth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from nearfield_server.benchmark.scenario import box_scenario, bundle_scenario
from nearfield_server.benchmark.server_times import measure
from nearfield_server.errors import AssetError
from nearfield_server.pipeline.runner import BackendName
from nearfield_server.records import LightSettings


def bench(
    out: Annotated[Path, typer.Option("--out", help="Folder for bench.json.")],
    room: Annotated[
        Path | None, typer.Option(help="Evaluation bundle; default: a box room in closed form.")
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="Interleaved rounds.")] = 15,
    backend: Annotated[str, typer.Option(help="auto, cpu or gl.")] = "auto",
    vals: Annotated[int, typer.Option(min=1, max=64, help="Slots for virtual area lights.")] = 16,
    ratio: Annotated[
        float | None, typer.Option(help="Fixed share of direct light; default: from the atlas.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small atlas and pictures, few rounds.")] = False,
) -> None:
    """Measure the light pipeline and write bench.json."""
    if backend not in ("auto", "cpu", "gl"):
        raise typer.BadParameter(f"expected auto, cpu or gl, found {backend!r}", param_hint="--backend")
    size = 256 if quick else 1024
    console = Console()
    scenario = box_scenario(size) if room is None else bundle_scenario(room)
    settings = LightSettings(num_vals=vals, split_ratio=ratio)
    name: BackendName = "cpu" if backend == "cpu" else "gl" if backend == "gl" else "auto"
    report = measure(scenario, settings, name, min(rounds, 5) if quick else rounds)
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "bench.json").write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise AssetError(f"{out}: cannot write bench.json: {error.strerror}; choose another --out") from error
    console.print(_table(report))
    console.print(f"{out / 'bench.json'}", highlight=False)


def _table(report: dict[str, Any]) -> Table:
    scene = report["scene"]
    title = f"{scene['name']}: {scene['texels']} texels, {scene['pairs']} pairs, {report['backend']}"
    table = Table(title=title)
    for heading in ("stage", "wall ms", "CPU ms", "x copy of 67 MB", "numpy CPU ms", "x faster"):
        table.add_column(heading, justify="left" if heading == "stage" else "right")
    rows = [
        *report["stages"].items(),
        ("whole update", report["update"]),
        ("object moved", report["object_moved"]),
    ]
    for name, row in rows:
        if row:
            values = (
                row[k] for k in ("wall_ms", "cpu_ms", "copies", "numpy_cpu_ms", "times_faster_than_numpy")
            )
            table.add_row(name, *("-" if value is None else f"{value:.2f}" for value in values))
    copy = report["copy_67_mb"]
    table.add_row("copy of 67 MB", f"{copy['wall_ms']:.2f}", f"{copy['cpu_ms']:.2f}", "1.00", "-", "-")
    table.add_row("unchanged update", f"{report['unchanged_us'] * 1e-3:.5f}", "-", "-", "-", "-")
    return table
