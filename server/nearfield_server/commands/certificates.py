"""`nearfield certificates`: who may join a room."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from nearfield_server.capture.remote.certificates import AUTHORITY_FILES, DEFAULT_DAYS, new_node, new_room

app = typer.Typer(help="Say which machines may join a room.", no_args_is_help=True, add_completion=False)

_Folder = Annotated[Path, typer.Argument(help="Folder of the room's certificates.")]
_Days = Annotated[int, typer.Option(min=1, max=3650, help="Validity, days.")]


@app.command()
def room(
    folder: _Folder,
    address: Annotated[
        list[str],
        typer.Option(help="IP address or host name under which nodes reach the service; may be repeated."),
    ],
    days: _Days = DEFAULT_DAYS,
) -> None:
    """Make the authority of a room, and the certificate of its service."""
    files = new_room(folder, address, days)
    sys.stdout.write(
        f"made {files.authority}, {AUTHORITY_FILES[1]} (keep it secret: whoever has it can let machines in), "
        f"{files.certificate.name} and {files.key.name}\n"
    )


@app.command()
def node(
    folder: _Folder,
    name: Annotated[
        str, typer.Argument(help="Name of the machine, as its node file and the room file have it.")
    ],
    days: _Days = DEFAULT_DAYS,
) -> None:
    """Make the certificate of a camera node; copy it there with its key and ca.pem."""
    files = new_node(folder, name, days)
    sys.stdout.write(
        f"made {files.certificate} and {files.key}; copy both, and {files.authority.name}, to the machine '{name}'\n"
    )
