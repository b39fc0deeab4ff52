"""`nearfield cameras`: what is connected."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from nearfield_server.onboarding.connected import as_json, as_table, list_connected
from nearfield_server.onboarding.finder import ThisMachinesFinder


def cameras(
    interface: Annotated[
        list[str] | None,
        typer.Option(
            help="Network interface on which GigE cameras are asked for, by a broadcast there and nowhere else; may be repeated."
        ),
    ] = None,
    address: Annotated[
        list[str] | None,
        typer.Option(help="Address of one GigE camera, which alone is asked; may be repeated."),
    ] = None,
    as_json_text: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """List the cameras that are connected. V4L2 and USB3 Vision are always listed; networks are asked only where you say."""
    listing = list_connected(ThisMachinesFinder(), tuple(interface or ()), tuple(address or ()))
    sys.stdout.write(as_json(listing) if as_json_text else as_table(listing))
