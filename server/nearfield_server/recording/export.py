"""What can be done with a recording frame by frame: read it all, or write it as OpenEXR files."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from nearfield_server.errors import AssetError
from nearfield_server.recording.files.exr_store import ExrWriter
from nearfield_server.recording.files.library import Recording
from nearfield_server.recording.files.light_log import LIGHT_FILE
from nearfield_server.recording.files.manifest import write_manifest
from nearfield_server.recording.snapshot import FILES_FOLDER
from nearfield_server.scene.room_config import ROOM_FILE


def verify_frames(recording: Recording) -> Iterator[str]:
    """Read every frame; yields words for each one that is damaged, and an empty text for the others."""
    for track in recording.tracks:
        for frame in track.frames:
            try:
                track.read(frame)
            except AssetError as error:
                yield str(error)
            else:
                yield ""


def export_exr(recording: Recording, folder: Path) -> Iterator[str]:
    """Write a recording of OpenEXR files with the same pixels, light log and room.

    Args:
        recording: of either format.
        folder: new.

    Yields:
        Per frame an empty text, or words if it is damaged and left out.

    Raises:
        AssetError: the disk refuses.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in (ROOM_FILE, LIGHT_FILE):
            if (recording.folder / name).is_file():
                shutil.copyfile(recording.folder / name, folder / name)
        if (recording.folder / FILES_FOLDER).is_dir():
            shutil.copytree(recording.folder / FILES_FOLDER, folder / FILES_FOLDER)
        writer = ExrWriter(folder, recording.manifest.cameras)
        try:
            for camera, track in enumerate(recording.tracks):
                for frame in track.frames:
                    try:
                        pixels = track.read(frame)
                    except AssetError as error:
                        yield str(error)
                        continue
                    writer.write(camera, frame.info, pixels)
                    yield ""
        finally:
            writer.close()
        # Last: without it the folder is no recording yet.
        write_manifest(folder, replace(recording.manifest, kind="exr"))
    except OSError as error:
        raise AssetError(f"{folder}: cannot be written ({error.strerror or error})") from error
