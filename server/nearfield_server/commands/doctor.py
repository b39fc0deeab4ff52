"""`nearfield doctor`: looks at this machine and says what to do before a room is served."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from nearfield_server.commands.serve import DEFAULT_PORT, LanOption, PortOption
from nearfield_server.doctor.examination import examine
from nearfield_server.doctor.finding import as_json, as_text, has_problem
from nearfield_server.doctor.machine import ThisMachine

BUILT_CLIENT = Path(__file__).resolve().parents[1] / "static"


def doctor(
    room: Annotated[
        Path | None,
        typer.Argument(help="Room that will be served: its cameras, links and buffers are checked too."),
    ] = None,
    port: PortOption = DEFAULT_PORT,
    lan: LanOption = False,
    recordings: Annotated[Path, typer.Option(help="Folder that recordings will go to.")] = Path(),
    as_json_text: Annotated[bool, typer.Option("--json", help="Print JSON instead of lines.")] = False,
) -> None:
    """Check libraries, permissions, buffers, graphics, ports and cameras; say what to do. Exit code 1 if something will not work."""
    host = "0.0.0.0" if lan else "127.0.0.1"
    findings = examine(
        ThisMachine(), room, static_dir=BUILT_CLIENT, recordings=recordings, port=port, host=host
    )
    sys.stdout.write(as_json(findings) if as_json_text else as_text(findings, colour=sys.stdout.isatty()))
    raise typer.Exit(1 if has_problem(findings) else 0)
