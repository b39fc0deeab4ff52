"""`nearfield replay`: serves a recording again, or checks that it gives the same light."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from nearfield_server.commands.serve import DEFAULT_PORT, LanOption, PortOption, run_service
from nearfield_server.errors import ConfigError


def replay(
    recording: Annotated[Path, typer.Argument(help="Folder of a recording.")],
    speed: Annotated[float, typer.Option(min=0.01, max=100.0, help="Times the original speed.")] = 1.0,
    as_fast_as_possible: Annotated[
        bool,
        typer.Option(
            "--as-fast-as-possible",
            help="Every recorded frame goes through the light pipeline, without a clock.",
        ),
    ] = False,
    loop: Annotated[bool, typer.Option("--loop/--once", help="Begin again after the end.")] = True,
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="Serve nothing: make the light again and compare every packet byte for byte."
        ),
    ] = False,
    backend: Annotated[str, typer.Option(help="Light stages on: auto, cpu, gl or reference.")] = "auto",
    port: PortOption = DEFAULT_PORT,
    lan: LanOption = False,
    bus_port: Annotated[int, typer.Option(min=0, max=65535, hidden=True)] = 0,
) -> None:
    """Replay a recording bit by bit: the page, the light and the pictures of that time. Ctrl-C ends it."""
    if backend not in ("auto", "cpu", "gl", "reference"):
        raise ConfigError(f"--backend {backend!r}: expected auto, cpu, gl or reference")
    # A wrong folder is told here, once, and not by every process of a service.
    from nearfield_server.recording.files.library import open_recording

    if check:
        raise typer.Exit(_check(recording, backend))
    found = open_recording(recording)
    for problem in found.problems:
        sys.stderr.write(f"nearfield: {problem}\n")
    if found.num_frames == 0:
        raise ConfigError(f"{recording}: the recording holds no frame")
    sys.exit(
        run_service(
            recording,
            port=port,
            lan=lan,
            allowed_hosts=[],
            backend=backend,
            replay={"speed": speed, "loop": loop, "lockstep": as_fast_as_possible},
            bus_port=bus_port,
        )
    )


def _check(folder: Path, backend: str) -> int:
    """0 if every packet is the same, 1 if not."""
    from nearfield_server.recording.check import check_identity

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("preparing the room", total=None)

        def say(done: int, total: int) -> None:
            progress.update(task, description="updates", completed=done, total=total)

        report = check_identity(folder, backend=None if backend == "auto" else backend, progress=say)
    for line in report.lines():
        console.print(line, highlight=False, soft_wrap=True)
    return 0 if report.is_identical else 1
