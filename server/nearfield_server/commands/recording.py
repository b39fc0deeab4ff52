"""`nearfield recording`: looks at recordings, verifies them, and turns raw ones into OpenEXR files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.recording.export import export_exr, verify_frames
from nearfield_server.recording.files.library import Recording, open_recording

app = typer.Typer(
    help="Look at recordings, verify and export them.", no_args_is_help=True, add_completion=False
)
Folder = Annotated[Path, typer.Argument(help="Folder of a recording.")]


@app.command()
def info(recording: Folder) -> None:
    """Say what a recording holds."""
    console = Console()
    found = open_recording(recording)
    for line in describe(found):
        console.print(line, highlight=False, soft_wrap=True)
    _problems(found.problems)


@app.command()
def verify(recording: Folder) -> None:
    """Read every frame of a recording; exit code 1 if anything is damaged, missing or cut off, or there is no frame."""
    found = open_recording(recording)
    damaged = list(_with_progress("verifying", found.num_frames, verify_frames(found)))
    problems = [words for words in damaged if words]
    _problems([*found.problems, *problems])
    Console().print(
        f"{found.num_frames - len(problems)} of {found.num_frames} frames are whole",
        highlight=False,
        soft_wrap=True,
    )
    # Frames that could not even be found are in nobody's count: only the problems tell of them.
    if problems or found.problems or not found.num_frames:
        raise typer.Exit(1)


@app.command()
def export(
    recording: Folder,
    to: Annotated[
        Path, typer.Option("--to", help="New folder for a recording of OpenEXR files, bit for bit the same.")
    ],
) -> None:
    """Turn a recording into one of OpenEXR files, which any picture tool opens."""
    found = open_recording(recording)
    if to.resolve().is_relative_to(recording.resolve()):
        raise ConfigError(f"{to}: expected a folder outside of the recording {recording}")
    if to.exists() and (not to.is_dir() or any(to.iterdir())):
        raise ConfigError(f"{to}: expected a new or empty folder")
    damaged = [
        words for words in _with_progress("exporting", found.num_frames, export_exr(found, to)) if words
    ]
    _problems([*found.problems, *damaged])
    Console().print(f"{to}: {found.num_frames - len(damaged)} frames", highlight=False, soft_wrap=True)
    if damaged:
        raise AssetError(f"{recording}: {len(damaged)} frames are damaged and were left out")


def describe(recording: Recording) -> Iterator[str]:
    """Lines for people."""
    manifest = recording.manifest
    yield f"{recording.folder}: room {manifest.room_name!r}, format {manifest.kind}, recorded by {manifest.software}"
    for take in manifest.takes:
        seconds = (take.ended_ns - take.started_ns) * 1e-9
        end = (
            f"{seconds:.1f} s, {take.reason}"
            if take.ended_ns
            else "not ended by itself (killed, or it still runs)"
        )
        yield f"take {take.number}: {take.started_utc}, {end}, {take.frames_dropped} frames lost"
    for track in recording.tracks:
        camera, infos = track.camera, track.infos
        if not infos:
            yield f"camera {camera.camera_id}: no frames"
            continue
        seconds = (infos[-1].timestamp_ns - infos[0].timestamp_ns) * 1e-9
        rate = f", {(len(infos) - 1) / seconds:.2f} frames/s" if seconds > 0 else ""
        yield f"camera {camera.camera_id}: {len(infos)} frames of {camera.width} x {camera.height} in {seconds:.1f} s{rate}"
    runs = recording.light_runs([])
    packets = sum(step.packet is not None for run in runs for step in run.updates)
    yield f"light: {sum(len(run.updates) for run in runs)} updates, {packets} packets"
    size = sum(path.stat().st_size for path in recording.folder.rglob("*") if path.is_file())
    yield f"{size / 1e6:.1f} MB on disk"


def _problems(problems: list[str] | tuple[str, ...]) -> None:
    console = Console(stderr=True)
    for problem in problems:
        console.print(problem, highlight=False, soft_wrap=True, style="yellow")


def _with_progress(words: str, total: int, steps: Iterator[str]) -> Iterator[str]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        yield from progress.track(steps, total=total, description=words)
