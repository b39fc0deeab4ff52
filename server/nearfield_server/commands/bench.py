"""`nearfield bench`: run time against error, next to the methods of the papers and to other renderers."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from nearfield_server.benchmark.assembly import failed_parts, run_parts
from nearfield_server.benchmark.parts import PARTS, BenchSetup
from nearfield_server.benchmark.summary import summary
from nearfield_server.pipeline.runner import BackendName

EMBEDDED_BUNDLE = Path(__file__).parents[1] / "rooms" / "lab"


def bench(
    out: Annotated[Path, typer.Option("--out", help="Folder for bench.json, the page and the plots.")],
    bundles: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[BUNDLE]...", help="Further bundles with path-traced truth."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Under ten minutes: fewer rounds, views, light counts and frames.")
    ] = False,
    only: Annotated[
        list[str] | None, typer.Option("--only", help=f"Run this part alone, repeatable: {', '.join(PARTS)}.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Keep what an interrupted run in the same folder finished.")
    ] = False,
    backend: Annotated[str, typer.Option(help="Of the light pipeline: auto, cpu or gl.")] = "auto",
    lab: Annotated[
        bool, typer.Option("--lab/--no-lab", help="Take part with the bundle that comes with Nearfield.")
    ] = True,
    tiny: Annotated[
        bool,
        typer.Option("--tiny", help="Smallest form, to prove that it works; its figures say nothing."),
    ] = False,
) -> None:
    """Measure server, client, every method, growth and latency; write bench.json after each part."""
    console = Console(stderr=True)
    # A request to end, like Ctrl-C, passes every `finally`: no service or browser that was started is left behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    names = _chosen_parts(only)
    setup = BenchSetup(
        quick=quick or tiny,
        tiny=tiny,
        bundles=((EMBEDDED_BUNDLE,) if lab else ()) + tuple(path.resolve() for path in bundles or ()),
        backend=_backend(backend),
        resume=resume,
        out=out,
        say=lambda text: console.print(text, highlight=False),
    )
    report = run_parts(setup, names)
    console.print(summary(report))
    console.print(f"{out / 'bench.json'}", highlight=False)
    # Draws with matplotlib, of the extra `bench`; the figures are written by now.
    from nearfield_server.benchmark.report import write_page

    console.print(f"{write_page(out, report)}", highlight=False)
    failed = failed_parts(report, names)
    for name, reason in failed.items():
        console.print(f"{name} failed: {reason}", highlight=False, style="red")
    if failed:
        raise typer.Exit(3)


def _chosen_parts(only: list[str] | None) -> tuple[str, ...]:
    unknown = [name for name in only or [] if name not in PARTS]
    if unknown:
        raise typer.BadParameter(f"expected {', '.join(PARTS)}, found {unknown[0]!r}", param_hint="--only")
    return tuple(name for name in PARTS if not only or name in only)


def _backend(name: str) -> BackendName:
    if name == "cpu":
        return "cpu"
    if name == "gl":
        return "gl"
    if name == "auto":
        return "auto"
    raise typer.BadParameter(f"expected auto, cpu or gl, found {name!r}", param_hint="--backend")
