"""`python -m nearfield_server.virtual_camera`: the same as `nearfield lab camera`, without loading other commands."""

from __future__ import annotations

import sys

import typer

from nearfield_server.errors import NearfieldError
from nearfield_server.virtual_camera.cli import camera


def main() -> None:
    """Run; deliberate errors become one line on standard error."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(camera)
    try:
        app()
    except NearfieldError as error:
        sys.stderr.write(f"virtual camera: {error}\n")
        sys.exit(3)


if __name__ == "__main__":
    main()
