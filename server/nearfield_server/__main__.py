"""The command line: `nearfield` or `python -m nearfield_server`."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from nearfield_server.commands.lazy import LazyGroup
from nearfield_server.errors import AssetError, ConfigError, NearfieldError

EXIT_ASSET = 1
EXIT_CONFIG = 2
EXIT_SERVICE = 3

app = typer.Typer(
    cls=LazyGroup,
    name="nearfield",
    help="Photorealistic augmented reality in the browser, lit by the real room.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        sys.stdout.write(f"nearfield {version('nearfield')}\n")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=_print_version, help="Show the version and exit."),
    ] = False,
) -> None:
    """Photorealistic augmented reality in the browser, lit by the real room."""


def exit_code(error: NearfieldError) -> int:
    """Return 1 for a broken file, 2 for a wrong setting, 3 for everything that fails while running."""
    if isinstance(error, AssetError):
        return EXIT_ASSET
    return EXIT_CONFIG if isinstance(error, ConfigError) else EXIT_SERVICE


def main() -> None:
    """Run the command line; deliberate errors become one message on standard error and an exit code from 1 to 3."""
    try:
        app()
    except NearfieldError as error:
        sys.stderr.write(f"nearfield: {error}\n")
        sys.exit(exit_code(error))


if __name__ == "__main__":
    main()
