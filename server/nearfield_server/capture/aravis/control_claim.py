"""A camera obeys one program, known by its address and port, for seconds after that program died. The next one need not wait for that.

Whoever opens a camera writes down the port from which he controls it. If the port is free when the camera is opened again, that program is
gone: control is given up in its name, from that port. Nothing can be taken away so from a program that lives: its port is not free.
"""

from __future__ import annotations

import contextlib
import os
import stat
import tempfile
from pathlib import Path

from nearfield_server.capture.aravis.gvcp import ControlChannel
from nearfield_server.errors import CaptureError


def claims_folder() -> Path:
    """Where ports are written down: gone after a restart of the machine, as the ports are."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return Path(runtime or tempfile.gettempdir()) / f"nearfield-cameras-{os.getuid()}"


def write_claim(camera: str, host: str, port: int) -> None:
    """Write down that the camera at an address is controlled from this port; without a place for it, nothing is written."""
    folder = claims_folder()
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        if _is_ours(folder):
            fresh = folder / f"{camera}.{os.getpid()}"
            fresh.write_text(f"{host} {port}\n", encoding="ascii")
            fresh.replace(folder / camera)


def give_up_for_the_dead(camera: str) -> bool:
    """Give up control of the camera at an address in the name of the program that wrote it down last, if that is gone; true if so."""
    claim = claims_folder() / camera
    try:
        if not _is_ours(claim.parent):
            return False
        host, port = claim.read_text(encoding="ascii").split()
        source = (host, int(port))
    except (OSError, ValueError):
        return False
    try:
        with ControlChannel(camera, source=source) as channel:
            channel.give_up_control()
    except CaptureError:
        return False  # the port is taken, the camera is gone, or obeys someone else
    claim.unlink(missing_ok=True)
    return True


def _is_ours(folder: Path) -> bool:
    """Whether nobody else could have written there (the folder may lie where all users may write)."""
    found = folder.lstat()
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022
