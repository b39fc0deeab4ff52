"""What the kernel's error numbers mean for a camera, and what to do about them."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from nearfield_server.errors import CaptureError

_GONE = (errno.ENODEV, errno.ENXIO, errno.ESHUTDOWN, errno.EPROTO)


def explain(error: OSError, camera_id: str, path: str, action: str) -> CaptureError:
    """Turn an error of the kernel into words.

    Args:
        error: as raised by a system call.
        camera_id: name of the camera in the room file; empty if it has none.
        path: of the device node.
        action: what was tried ("open the device").
    """
    where = f"{f'camera {camera_id} ({path})' if camera_id else path}: cannot {action}: "
    if error.errno == errno.ENOENT:
        return CaptureError(f"{where}there is no such device; is it plugged in? {_present(path)}")
    if error.errno in (errno.EACCES, errno.EPERM):
        return CaptureError(
            f"{where}permission denied; add the user to the group that owns the device "
            f"(sudo usermod -aG {_group_of(path)} {_user()}), then log in again"
        )
    if error.errno == errno.EBUSY:
        holders = holders_of(path)
        by = ", ".join(f"{name} (process {pid})" for pid, name in holders) or "another program"
        return CaptureError(f"{where}it is in use by {by}; end that program or take another camera")
    if error.errno in _GONE:
        return CaptureError(
            f"{where}the camera is gone; it is opened again as soon as it is plugged in again"
        )
    if error.errno == errno.ENOSPC:
        return CaptureError(
            f"{where}the USB bus has no room for another stream; use another USB controller, a smaller picture, "
            "a lower frame rate or a compressed format"
        )
    if error.errno == errno.ENOMEM:
        return CaptureError(f"{where}the kernel has no memory for its buffers; use a smaller picture")
    if error.errno == errno.ENOTTY:
        return CaptureError(f"{where}the device does not offer this; is it a video capture node?")
    if error.errno in (errno.EIO, errno.ETIMEDOUT, errno.EPIPE, errno.EOVERFLOW):
        return CaptureError(f"{where}the camera fails ({error.strerror}); check cable, hub and power")
    return CaptureError(f"{where}{error.strerror or error}")


def holders_of(path: str) -> list[tuple[int, str]]:
    """Return (process id, name) of the other processes that have a device node open, as far as this user may see them."""
    try:
        wanted = os.stat(path).st_rdev
    except OSError:
        return []
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        if int(process.name) == os.getpid():
            continue
        try:
            if any(_device_of(entry) == wanted for entry in (process / "fd").iterdir()):
                name = (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
                found.append((int(process.name), name))
        except OSError:
            continue  # it ended meanwhile, or belongs to someone else
    return sorted(found)


def _device_of(entry: Path) -> int | None:
    """Device number behind an opened file; None if it was closed meanwhile."""
    try:
        return entry.stat().st_rdev
    except OSError:
        return None


def _present(path: str) -> str:
    """The devices that are there, in the words of a message."""
    folder = Path(path).parent
    names = sorted(str(entry) for entry in folder.glob("*")) if folder != Path("/dev") else []
    names = names or sorted(str(entry) for entry in Path("/dev").glob("video*"))
    return f"Present: {', '.join(names)}" if names else "No video device is present"


def _group_of(path: str) -> str:
    try:
        return Path(path).group()
    except (OSError, KeyError):
        return "video"


def _user() -> str:
    return os.environ.get("USER") or "$USER"
