"""Writing room files: whole or not at all, loadable or not at all, and never over a file that nobody offered."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Sequence
from pathlib import Path

from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.onboarding.room_text import PlannedCamera, new_room_text, with_cameras
from nearfield_server.scene.room_config import RoomConfig, load_room


def create_room(
    path: Path,
    cameras: Sequence[PlannedCamera],
    *,
    name: str,
    model: Path,
    frame_rate: float = 10.0,
    overwrite: bool = False,
) -> RoomConfig:
    """Write a new room file.

    Args:
        path: the file.
        cameras: at least one.
        name: of the room.
        model: GLB of the room; it is named relative to the folder of the room file.
        frame_rate: frames per second asked of the cameras.
        overwrite: replace a file that is there.

    Returns:
        The room as `load_room` reads it back.

    Raises:
        ConfigError: there is a file already, or what would be written is no valid room.
        AssetError: there is no such model, or the folder cannot be written to.
    """
    if not model.is_file():
        raise AssetError(f"{model}: no such model. Give the GLB of the room.")
    relative = os.path.relpath(model.resolve(), path.absolute().parent.resolve())
    text = new_room_text(name, relative.replace(os.sep, "/"), frame_rate, cameras)
    return _write(path, text, overwrite=overwrite)


def add_cameras(path: Path, cameras: Sequence[PlannedCamera]) -> RoomConfig:
    """Add cameras at the end of a room file.

    Returns:
        The room as `load_room` reads it back.

    Raises:
        ConfigError: the file is no TOML or no valid room with these cameras in it.
        AssetError: it cannot be read or written.
    """
    try:
        with open(path, encoding="utf-8", newline="") as file:
            before = file.read()
    except (OSError, UnicodeDecodeError) as error:
        raise AssetError(f"{path}: cannot be read ({error})") from error
    try:
        text = with_cameras(before, cameras)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    return _write(path, text, overwrite=True)


def _write(path: Path, text: str, *, overwrite: bool) -> RoomConfig:
    if path.suffix != ".toml":
        raise ConfigError(f"{path}: expected a name that ends in .toml")
    partial = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.toml")
    try:
        with open(partial, "x", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        try:
            load_room(partial)
        except (ConfigError, AssetError) as error:
            raise type(error)(str(error).replace(str(partial), str(path))) from error
        if overwrite:
            if path.exists():
                os.chmod(partial, path.stat().st_mode & 0o7777)
            os.replace(partial, path)
        else:
            os.link(partial, path)  # unlike a rename it fails if the name is taken
    except FileExistsError:
        raise ConfigError(
            f"{path}: exists already; add to it with --room, or replace it with --overwrite"
        ) from None
    except OSError as error:
        raise AssetError(f"{path}: cannot be written ({error.strerror})") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()
    return load_room(path)
