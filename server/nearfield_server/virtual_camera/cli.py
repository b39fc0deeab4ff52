"""`nearfield lab camera`: a simulated GigE Vision camera in front of a room."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer


def camera(
    room: Annotated[
        Path,
        typer.Argument(help="A room with simulated cameras: room.toml, scene.json, or a folder with one."),
    ],
    camera: Annotated[str, typer.Option("--camera", help="Which camera of the room.")],
    address: Annotated[
        str, typer.Option(help="Address of loopback that it serves on, 127.0.0.0/8; one camera per address.")
    ],
    serial: Annotated[
        str | None, typer.Option(help="Serial number; default: TEST- and the camera's name.")
    ] = None,
    full_well_radiance: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="Radiance that fills a pixel in one second, W/(sr m^2): `radiance_per_code` of the room file.",
        ),
    ] = 1.0,
    full_well_electrons: Annotated[
        float, typer.Option(min=1.0, help="Electrons of a full pixel.")
    ] = 10_000.0,
    read_noise_electrons: Annotated[
        float, typer.Option(min=0.0, help="Noise of the read-out, electrons.")
    ] = 3.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise.")] = 1,
    formats: Annotated[
        str | None,
        typer.Option(
            help="Pixel formats that it offers, separated by commas; the first is set. Default: all."
        ),
    ] = None,
    exposure_delay: Annotated[
        int,
        typer.Option(
            min=0, max=16, help="Frames after a change of the exposure that still have the old one."
        ),
    ] = 0,
    control: Annotated[
        bool,
        typer.Option(
            "--control", help="Take commands as lines of JSON from standard input, and end with it."
        ),
    ] = False,
) -> None:
    """Show a camera of a room as a real GigE Vision device. Runs only in a network namespace that has loopback alone; Ctrl-C ends it."""
    from nearfield_server.bus.worker import die_with_parent
    from nearfield_server.capture.sensor_model import SensorModel
    from nearfield_server.errors import ConfigError
    from nearfield_server.scene.room_config import load_room
    from nearfield_server.virtual_camera.device import CameraSetup, VirtualCamera, check_network, with_formats
    from nearfield_server.virtual_camera.process import serve
    from nearfield_server.virtual_camera.scenery import Scenery

    if full_well_radiance == 0.0:
        raise ConfigError("--full-well-radiance 0: expected a radiance above 0, W/(sr m^2)")
    check_network(address)
    if control:
        die_with_parent(os.getppid())
    setup = CameraSetup(
        address=address,
        serial=serial or f"TEST-{camera}",
        sensor=SensorModel(
            full_well_radiance=full_well_radiance,
            full_well_electrons=full_well_electrons,
            read_noise_electrons=read_noise_electrons,
            seed=seed,
        ),
        exposure_delay=exposure_delay,
    )
    if formats is not None:
        setup = with_formats(setup, tuple(formats.split(",")))
    device = VirtualCamera(setup, Scenery(load_room(room), camera))
    serve(device, sys.stdin if control else None, sys.stdout)
    sys.stdout.flush()
    # The interpreter is not taken apart: a thread of libaravis may be drawing.
    os._exit(0)
