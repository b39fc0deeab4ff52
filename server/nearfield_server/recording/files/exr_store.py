"""Recorded frames as OpenEXR files: one folder per camera, opened by ordinary tools, with an `index.jsonl` beside them.

A frame is written under another name, renamed, and then named in the index; what a killed recorder leaves behind (a `.tmp`, a frame
without a line) is passed over by readers.
"""

from __future__ import annotations

import io
import os
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from nearfield_server.errors import AssetError
from nearfield_server.recording.files.frame_info import FrameInfo, info_from_fields
from nearfield_server.recording.files.json_lines import LineWriter, read_lines
from nearfield_server.recording.files.manifest import CameraEntry
from nearfield_server.scene.exr import read_size
from nearfield_server.whole_file import whole_file

FRAMES_FOLDER: Final = "frames"
INDEX_FILE: Final = "index.jsonl"
ALPHA_MEANING: Final = (
    "1 valid; 0 unknown; 0.99951171875 (half 0x3BFF) radiance is a lower bound: saturated in every exposure"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExrFrame:
    """Where a frame is."""

    info: FrameInfo
    path: Path


def camera_folder(folder: Path, camera: CameraEntry) -> Path:
    """Where the frames of a camera are."""
    return folder / FRAMES_FOLDER / camera.camera_id


def file_name(info: FrameInfo) -> str:
    """Name of a frame's file; names sort in the order of recording."""
    return f"{info.take:04d}_{info.sequence:010d}.exr"


def exr_header(camera: CameraEntry, info: FrameInfo) -> dict[str, Any]:
    """Attributes of a frame's header. Whole numbers beyond 32 bit and doubles are strings: EXR has no such types."""
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "nearfield.camera": camera.camera_id,
        "nearfield.calibration": camera.calibration_id,
        "nearfield.timestampNs": str(info.timestamp_ns),
        "nearfield.take": str(info.take),
        "nearfield.sequence": str(info.sequence),
        "nearfield.alpha": ALPHA_MEANING,
        "nearfield.frame": info.to_json(),
    }
    for name in ("exposures_s", "gains", "device_ns"):
        if name in info.metadata:
            value = info.metadata[name]
            listed = value if isinstance(value, list) else [value]
            header[f"nearfield.{name}"] = " ".join(str(entry) for entry in listed)
    exposures = info.metadata.get("exposures_s")
    if isinstance(exposures, list) and exposures and all(isinstance(value, float) for value in exposures):
        header["expTime"] = float(max(exposures))  # the standard attribute has room for one
    return header


def encode_exr(camera: CameraEntry, info: FrameInfo, pixels: NDArray[np.float16]) -> bytes:
    """A whole file in memory: half-float RGBA, lossless ZIP."""
    stream = io.BytesIO()
    data = np.ascontiguousarray(pixels)
    OpenEXR.File(exr_header(camera, info), {"RGBA": data}).write(stream)
    return stream.getvalue()


class ExrWriter:
    """Writes frames of all cameras; frames of one camera come from one thread.

    Raises:
        OSError: from every method, when the disk refuses; the frame in hand is then not there.
    """

    def __init__(self, folder: Path, cameras: tuple[CameraEntry, ...]) -> None:
        self._cameras = cameras
        self._folders = [camera_folder(folder, camera) for camera in cameras]
        for path in self._folders:
            path.mkdir(parents=True, exist_ok=True)
        self._indices = [LineWriter(path / INDEX_FILE) for path in self._folders]
        self._lock = threading.Lock()
        self._unsynced: list[Path] = []

    def write(self, camera: int, info: FrameInfo, pixels: NDArray[np.float16]) -> int:
        """Write a frame (H, W, 4) and return its bytes on disk."""
        data = encode_exr(self._cameras[camera], info, pixels)
        name = file_name(info)
        path = self._folders[camera] / name
        with whole_file(path) as partial:
            partial.write_bytes(data)
        line = f'{{"file":"{name}",{info.to_json()[1:]}'
        try:
            size = len(data) + self._indices[camera].write(line)
        except OSError:
            path.unlink(missing_ok=True)
            raise
        with self._lock:
            self._unsynced.append(path)
        return size

    def sync(self) -> None:
        """Wait until the disk has everything written so far: frames first, then the lines that name them."""
        with self._lock:
            paths, self._unsynced = self._unsynced, []
        for path in [*paths, *self._folders]:
            fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(fd)
            finally:
                os.close(fd)
        for index in self._indices:
            index.sync()

    def close(self) -> None:
        """Sync and close."""
        try:
            self.sync()
        finally:
            for index in self._indices:
                index.close()


def find_exr_frames(folder: Path, camera: CameraEntry, problems: list[str]) -> list[ExrFrame]:
    """Frames that the index of a camera names and that exist, in the order of recording.

    Args:
        folder: of the recording.
        camera: of the manifest.
        problems: what was passed over is told here, in words.
    """
    place = camera_folder(folder, camera)
    index = place / INDEX_FILE
    frames: dict[tuple[int, int], ExrFrame] = {}
    for number, fields in read_lines(index, problems):
        try:
            info = info_from_fields(fields)
            if fields.get("file") != file_name(info):
                raise ValueError(
                    f"file: expected {file_name(info)!r}, found {str(fields.get('file'))[:60]!r}"
                )
        except ValueError as error:
            problems.append(f"{index}:{number}: {error}")
            continue
        path = place / file_name(info)
        if not path.is_file():
            problems.append(f"{index}:{number}: {path.name} is missing")
            continue
        frames[info.key] = ExrFrame(info=info, path=path)
    return [frames[key] for key in sorted(frames)]


def read_exr_frame(frame: ExrFrame, camera: CameraEntry) -> NDArray[np.float16]:
    """Read a frame's pixels, (H, W, 4) float16, bit for bit as they were recorded.

    Raises:
        AssetError: damaged, or not the picture that the manifest describes.
    """
    size = read_size(frame.path)
    if size != (camera.height, camera.width):
        raise AssetError(
            f"{frame.path}: {size[1]} x {size[0]} pixels, expected {camera.width} x {camera.height}"
        )
    try:
        channel = OpenEXR.File(str(frame.path)).channels().get("RGBA")
    except (RuntimeError, ValueError) as error:
        raise AssetError(f"{frame.path}: pixels cannot be read, the file is damaged ({error})") from error
    pixels = None if channel is None else channel.pixels
    if pixels is None or pixels.dtype != np.float16 or pixels.shape != (*size, 4):
        raise AssetError(f"{frame.path}: expected half-float channels R, G, B, A")
    return np.ascontiguousarray(pixels)
