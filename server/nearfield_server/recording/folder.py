"""The folder of a recording at the start of a recorder: a new one, or the next take of one that a killed recorder left behind."""

from __future__ import annotations

import time
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from nearfield_server.errors import AssetError, ServiceError
from nearfield_server.recording.files.manifest import (
    MANIFEST_FILE,
    CameraEntry,
    Kind,
    Manifest,
    TakeEntry,
    boot_id,
    calibration_id,
    read_manifest,
    write_manifest,
)
from nearfield_server.recording.snapshot import safe_names
from nearfield_server.scene.room_config import RoomConfig


def check_target(folder: Path) -> None:
    """Refuse a folder that a new recording must not go into.

    Raises:
        ServiceError: it holds something, or cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise ServiceError(
                f"{folder}: a recording needs a new or empty folder, and this one holds something"
            )
        probe = folder / ".probe.tmp"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise ServiceError(f"{folder}: a recording cannot be put there ({error.strerror})") from error


def camera_entries(room: RoomConfig) -> tuple[CameraEntry, ...]:
    """The cameras of a room as the manifest has them."""
    names = safe_names([camera.camera_id for camera in room.cameras])
    return tuple(
        CameraEntry(
            camera_id=name,
            height=camera.intrinsics.height,
            width=camera.intrinsics.width,
            calibration_id=calibration_id(camera),
        )
        for name, camera in zip(names, room.cameras, strict=True)
    )


def begin_take(folder: Path, kind: Kind, room: RoomConfig) -> tuple[Manifest, TakeEntry]:
    """Write the manifest with a new take and return both.

    Raises:
        ServiceError: the folder holds another recording.
        OSError: the disk refuses.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cameras = camera_entries(room)
    fresh = Manifest(
        kind=kind,
        room_name=room.name,
        software=_software(),
        boot_id=boot_id(),
        frame_rate=room.frame_rate,
        cameras=cameras,
        takes=(),
    )
    number = 1
    if (folder / MANIFEST_FILE).is_file():
        try:
            found = read_manifest(folder)
        except AssetError as error:
            raise ServiceError(
                f"{folder}: holds a damaged recording ({error}); choose another folder"
            ) from error
        if (found.kind, found.boot_id, found.cameras) != (kind, fresh.boot_id, cameras):
            raise ServiceError(f"{folder}: holds another recording; choose another folder")
        number = max(take.number for take in found.takes) + 1
        fresh = replace(fresh, takes=found.takes)
    take = TakeEntry(
        number=number,
        started_ns=time.monotonic_ns(),
        started_utc=datetime.now(UTC).isoformat(timespec="milliseconds"),
    )
    manifest = fresh.with_take(take)
    write_manifest(folder, manifest)
    return manifest, take


def _software() -> str:
    try:
        return version("nearfield")
    except PackageNotFoundError:
        return "source tree"
