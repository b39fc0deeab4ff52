"""`nearfield capture`: the cameras of this machine for a service on another one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from nearfield_server.errors import ConfigError


def capture(
    node: Annotated[
        Path, typer.Argument(help="node.toml: this machine's cameras, and where the service is.")
    ],
    full_well: Annotated[
        float | None,
        typer.Option(
            min=0.0, help="Give simulated cameras a noisy sensor that saturates at this radiance, W/(sr m^2)."
        ),
    ] = None,
) -> None:
    """Send the cameras of this machine to the service of a room. Ctrl-C ends it; it waits for the service, and joins again by itself."""
    from nearfield_server.supervisor.node import run_node

    if full_well == 0.0:
        raise ConfigError("--full-well 0: expected a radiance above 0, W/(sr m^2)")
    sys.exit(run_node(node, sensor=None if full_well is None else {"full_well_radiance": full_well}))
