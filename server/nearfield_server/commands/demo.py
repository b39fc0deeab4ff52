"""`nearfield demo`: the room that comes with the package, without any hardware."""

from __future__ import annotations

import sys
from pathlib import Path

import nearfield_server
from nearfield_server.commands.serve import DEFAULT_PORT, LanOption, PortOption, run_service
from nearfield_server.errors import AssetError


def demo_room() -> Path:
    """Return the folder of the shipped room.

    Raises:
        AssetError: this installation has none.
    """
    folder = Path(nearfield_server.__file__).parent / "rooms" / "lab"
    if not any((folder / name).is_file() for name in ("room.toml", "scene.json")):
        raise AssetError(
            f"{folder}: the demo room is missing from this installation. Install Nearfield again, make a room with "
            "`nearfield lab generate`, or serve your own with `nearfield serve ROOM`"
        )
    return folder


def demo(port: PortOption = DEFAULT_PORT, lan: LanOption = False) -> None:
    """Serve the room that comes with Nearfield: simulated cameras, lamps to switch, objects to move. Ctrl-C ends it."""
    sys.exit(run_service(demo_room(), port=port, lan=lan, allowed_hosts=[]))
