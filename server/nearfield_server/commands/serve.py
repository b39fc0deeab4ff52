"""`nearfield serve`: runs the whole service in the foreground."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from nearfield_server.bus.worker import die_with_parent
from nearfield_server.errors import ConfigError, ServiceError
from nearfield_server.recording.files.manifest import KINDS
from nearfield_server.recording.folder import check_target
from nearfield_server.supervisor.launcher import Launcher, free_loopback_port
from nearfield_server.supervisor.settings import ServiceSettings

DEFAULT_PORT = 8080

PortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="TCP port of the page; 0 takes any free one.")
]
LanOption = Annotated[
    bool, typer.Option("--lan", help="Serve to the local network, not to this machine alone.")
]


def serve(
    room: Annotated[Path, typer.Argument(help="room.toml, scene.json, or a folder with one of them.")],
    port: PortOption = DEFAULT_PORT,
    lan: LanOption = False,
    allow_host: Annotated[
        list[str] | None,
        typer.Option(help="Further host name that the page may be opened under; may be repeated."),
    ] = None,
    vals: Annotated[
        int | None, typer.Option(min=8, max=64, help="Virtual area lights; default: as the room file says.")
    ] = None,
    ratio: Annotated[
        float | None,
        typer.Option(
            min=0.0, max=1.0, help="Share of direct light, above 0; default: as the room file says."
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(min=0.1, max=240.0, help="Frames per second; default: as the room file says."),
    ] = None,
    backend: Annotated[str, typer.Option(help="Light stages on: auto, cpu, gl or reference.")] = "auto",
    sequence: Annotated[
        str | None, typer.Option(help="Lighting sequence of a bundle that its simulated cameras play.")
    ] = None,
    full_well: Annotated[
        float | None,
        typer.Option(
            min=0.0, help="Give simulated cameras a noisy sensor that saturates at this radiance, W/(sr m^2)."
        ),
    ] = None,
    record: Annotated[
        Path | None, typer.Option("--record", help="Record from the start into this new folder.")
    ] = None,
    record_format: Annotated[
        str, typer.Option(help="Of --record: exr (OpenEXR files) or raw (MCAP, for full rate).")
    ] = "exr",
    bus_port: Annotated[
        int, typer.Option(min=0, max=65535, hidden=True, help="Port of the message bus.")
    ] = 0,
    end_with: Annotated[
        int, typer.Option(min=0, hidden=True, help="Process id of the parent with which the service ends.")
    ] = 0,
) -> None:
    """Serve a room: cameras in, light and page out. Ctrl-C ends it."""
    if backend not in ("auto", "cpu", "gl", "reference"):
        raise ConfigError(f"--backend {backend!r}: expected auto, cpu, gl or reference")
    if ratio == 0.0:
        raise ConfigError("--ratio 0: expected a share above 0 and at most 1")
    if full_well == 0.0:
        raise ConfigError("--full-well 0: expected a radiance above 0, W/(sr m^2)")
    if end_with:
        die_with_parent(end_with, signal.SIGTERM)
    sys.exit(
        run_service(
            room,
            port=port,
            lan=lan,
            allowed_hosts=allow_host or [],
            num_vals=vals,
            split_ratio=ratio,
            frame_rate=rate,
            backend=backend,
            timeline=sequence,
            sensor=None if full_well is None else {"full_well_radiance": full_well},
            record=None if record is None else recording_options(record, record_format),
            bus_port=bus_port,
        )
    )


def recording_options(folder: Path, kind: str) -> dict[str, Any]:
    """What the service is told of a recording.

    Raises:
        ConfigError: no such format, or a folder that a recording cannot go into.
    """
    if kind not in KINDS:
        raise ConfigError(f"format {kind!r}: expected one of {', '.join(KINDS)}")
    try:
        check_target(folder)
    except ServiceError as error:
        raise ConfigError(str(error)) from error
    return {"folder": str(folder.resolve()), "kind": kind}


def run_service(
    room: Path, *, port: int, lan: bool, allowed_hosts: list[str], bus_port: int = 0, **settings: Any
) -> int:
    """Run a service until it ends and return its exit code.

    Raises:
        ConfigError: there is no such room.
    """
    if not room.exists():
        raise ConfigError(
            f"{room}: no such room. Give a room.toml, a scene.json, or a folder that holds one."
        )
    return Launcher(
        ServiceSettings(
            room_path=str(room.resolve()),
            host="0.0.0.0" if lan else "127.0.0.1",
            port=port,
            bus_port=bus_port or free_loopback_port(),
            launcher_pid=0,
            gateway={"lan": lan, "allowed_hosts": allowed_hosts},
            **settings,
        )
    ).run()
