"""`nearfield prepare`: computes everything that lighting a virtual object needs beforehand."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from nearfield_server.errors import ConfigError
from nearfield_server.scene.model_source import load_source_model
from nearfield_server.scene.prepare import DEFAULT_PRESET, prepare_model


def prepare(
    model: Annotated[Path, typer.Argument(help="GLB of the object, in metres, +y up.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Default: MODEL.prepared.glb beside it.")
    ] = None,
    preset: Annotated[
        str, typer.Option(help="Visibility samples per vertex: preview 100, medium 625, high 2500.")
    ] = DEFAULT_PRESET,
    albedo: Annotated[
        str | None, typer.Option(help="Linear red,green,blue in [0, 1] instead of the material's colour.")
    ] = None,
) -> None:
    """Prepare a virtual object: light transfer per vertex, shadow proxy, occlusion field."""
    console = Console(stderr=True)
    target = out if out is not None else model.with_name(f"{model.stem}.prepared.glb")
    colour = None if albedo is None else parse_albedo(albedo)
    for note in load_source_model(model).notes:
        console.print(f"{model.name}: {note}", highlight=False)
    started = time.perf_counter()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def show(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total)
            bar.update(tasks[stage], completed=done)

        prepared = prepare_model(model, preset, target, albedo=colour, progress=show)
    nx, ny, nz = prepared.occlusion_field.resolution
    console.print(
        f"{target}: {len(prepared.positions)} vertices, preset {preset}, {time.perf_counter() - started:.1f} s\n"
        f"  shadow proxy: {len(prepared.proxy.faces)} faces, at most {1000 * prepared.proxy.hausdorff:.2f} mm off; "
        f"occlusion field: {nx} x {ny} x {nz}; self-interreflection ratio {prepared.transfer.bounce_ratio:.3f}",
        highlight=False,
    )


def parse_albedo(text: str) -> NDArray[np.float64]:
    """Three comma-separated numbers.

    Raises:
        ConfigError: anything else.
    """
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        values = np.empty(0)
    if values.shape != (3,) or not np.all((values >= 0.0) & (values <= 1.0)):
        raise ConfigError(f"--albedo {text!r}: expected three numbers in [0, 1] such as 0.7,0.7,0.7")
    return values
