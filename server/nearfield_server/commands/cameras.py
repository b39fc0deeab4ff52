"""`nearfield cameras`: what is connected, what it sees, and a room file for it."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from nearfield_server.errors import CaptureError, ConfigError
from nearfield_server.onboarding.connected import FREE, Listing, as_json, as_table, list_connected
from nearfield_server.onboarding.finder import ThisMachinesFinder
from nearfield_server.onboarding.opening import open_camera
from nearfield_server.onboarding.room_text import free_camera_id
from nearfield_server.onboarding.session import CameraChoice, SetupSession
from nearfield_server.onboarding.source_plan import choose_pixel_format

SETUP_PORT = 8090


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
    setup: Annotated[
        bool,
        typer.Option(
            "--setup", help="Serve a page to this machine that shows the cameras and writes the room file."
        ),
    ] = False,
    room: Annotated[
        Path, typer.Option(help="Room file that the page writes, or adds cameras to if it is there.")
    ] = Path("room.toml"),
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="TCP port of that page; 0 takes any free one.")
    ] = SETUP_PORT,
    write_room: Annotated[
        Path | None,
        typer.Option(
            help="Write this room file with all free cameras, or add those that it does not have yet."
        ),
    ] = None,
    model: Annotated[Path | None, typer.Option(help="GLB of the room, for a new room file.")] = None,
    name: Annotated[str, typer.Option(help="Name of a new room; default: that of its folder.")] = "",
    field: Annotated[
        float, typer.Option(min=30.0, max=300.0, help="Full angle that the lenses show, degrees.")
    ] = 180.0,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Let --write-room replace a file that is there.")
    ] = False,
) -> None:
    """List the cameras that are connected. V4L2 and USB3 Vision are always listed; networks are asked only where you say."""
    if setup and write_room is not None:
        raise ConfigError(
            "--setup and --write-room: expected one of them; the page writes the room file itself"
        )

    def search() -> Listing:
        return list_connected(ThisMachinesFinder(), tuple(interface or ()), tuple(address or ()))

    if not setup and write_room is None:
        listing = search()
        sys.stdout.write(as_json(listing) if as_json_text else as_table(listing))
        return
    session = SetupSession(search, open_camera, write_room or room)
    try:
        session.search()
        if setup:
            serve_page(session, port)
        else:
            sys.stdout.write(
                write_all(session, model=model, name=name, field_degrees=field, overwrite=overwrite)
            )
    finally:
        session.close()


def write_all(
    session: SetupSession,
    *,
    model: Path | None,
    name: str = "",
    field_degrees: float = 180.0,
    overwrite: bool = False,
) -> str:
    """Write a room file with every free camera of the listing that it does not have; one look through each gives its lens.

    Args:
        session: after a search.
        model: GLB of a new room; None where the room is there.
        name: of a new room.
        field_degrees: full angle that the lenses show.
        overwrite: replace a room that is there instead of adding to it.

    Returns:
        Lines for the terminal: what was written, what was left out and why.

    Raises:
        ConfigError, AssetError: nothing can be written.
    """
    before = session.room()
    if before.problem:
        raise ConfigError(before.problem)
    is_new = overwrite or not before.exists
    if is_new and model is None:
        raise ConfigError(f"{session.room_path}: a new room needs --model, the GLB of its surfaces")
    taken = [] if is_new else list(before.camera_ids)
    lines: list[str] = []
    choices: list[CameraChoice] = []
    for index, camera in enumerate(session.listing.cameras):
        if not is_new and camera.place in before.places:
            lines.append(f"{camera.name} ({camera.place}): is in the room already")
            continue
        if camera.state != FREE or choose_pixel_format(camera.kind, camera.pixel_formats) is None:
            reason = camera.advice or "none of its pixel formats can be read"
            lines.append(f"{camera.name} ({camera.place}): left out, {camera.state}. {reason}")
            continue
        camera_id = free_camera_id(taken)
        taken.append(camera_id)
        exposure_s, seen = _look(session, index)
        lines.append(f"{camera.name} ({camera.place}): {camera_id}, {seen}")
        choices.append(
            CameraChoice(index=index, camera_id=camera_id, exposure_s=exposure_s, field_degrees=field_degrees)
        )
    if not choices:
        found = "".join(f"\n{line}" for line in [*lines, *session.listing.notes])
        raise ConfigError(f"{session.room_path}: nothing to write, no free camera was found{found}")
    written = session.write(choices, name=name, model=model, overwrite=overwrite)
    count = len(written.cameras)
    return "\n".join(
        [
            *lines,
            f"{session.room_path}: {'written' if is_new else 'added to'}; {count} {'camera' if count == 1 else 'cameras'}.",
            "Lenses are guesses and poses unknown: calibrate before you trust the light.",
            f"Next: nearfield doctor {session.room_path}",
            "",
        ]
    )


def _look(session: SetupSession, index: int) -> tuple[float | None, str]:
    """Exposure and lens of a camera, by looking through it; the exposure in seconds if it can be set, and what came of it in words."""
    try:
        look = session.expose(index)
    except (CaptureError, ConfigError) as error:
        return None, f"lens unknown, because it could not be looked through: {error}"
    shortest, longest = look.exposure_range_s
    found = "found" if look.has_circle else "not found"
    seen = f"image circle {found} in {look.width} x {look.height} pixels, exposed for {1e3 * look.exposure_s:.3g} ms"
    return look.exposure_s if shortest < longest else None, seen


def serve_page(session: SetupSession, port: int, stop: Callable[[], None] | None = None) -> None:
    """Serve the set-up page to this machine until Ctrl-C, or until `stop()` returns."""
    from nearfield_server.gateway.server import serve_in_thread
    from nearfield_server.gateway.setup_app import create_setup_app

    with serve_in_thread(create_setup_app(session), port=port) as url:
        sys.stdout.write(f"Connect cameras at {url}   (this machine only; Ctrl-C ends it)\n")
        sys.stdout.flush()
        try:
            (stop or threading.Event().wait)()
        except KeyboardInterrupt:
            sys.stdout.write("\n")
