"""A recording that is there: its manifest, the frames of every camera, the light log, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nearfield_server.recording.files.exr_store import ExrFrame, find_exr_frames, read_exr_frame
from nearfield_server.recording.files.frame_info import FrameInfo
from nearfield_server.recording.files.light_log import LightRun, read_light_log
from nearfield_server.recording.files.manifest import CameraEntry, Manifest, read_manifest
from nearfield_server.recording.files.raw_store import RawFrame, find_raw_frames, read_raw_frame

StoredFrame = ExrFrame | RawFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """One camera of a recording, frames in the order of recording."""

    camera: CameraEntry
    frames: tuple[StoredFrame, ...]

    def read(self, frame: StoredFrame) -> NDArray[np.float16]:
        """Pixels (H, W, 4) float16, bit for bit as recorded.

        Raises:
            AssetError: damaged.
        """
        if isinstance(frame, ExrFrame):
            return read_exr_frame(frame, self.camera)
        return read_raw_frame(frame, self.camera)

    @property
    def infos(self) -> tuple[FrameInfo, ...]:
        """What is known of every frame."""
        return tuple(frame.info for frame in self.frames)


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A recording on disk.

    Attributes:
        folder: where it is.
        manifest: what it is of.
        tracks: one per camera.
        problems: in words: lines, frames and segments that were passed over.
    """

    folder: Path
    manifest: Manifest
    tracks: tuple[Track, ...]
    problems: tuple[str, ...]

    @property
    def num_frames(self) -> int:
        """Frames of all cameras."""
        return sum(len(track.frames) for track in self.tracks)

    def light_runs(self, problems: list[str]) -> list[LightRun]:
        """The light log, see `read_light_log`."""
        return read_light_log(self.folder, problems)


def open_recording(folder: str | Path) -> Recording:
    """Find everything that a recording holds; tolerates all that a killed recorder leaves behind.

    Raises:
        AssetError: the folder is no recording.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    problems: list[str] = []
    if manifest.kind == "raw":
        found = find_raw_frames(folder, manifest.cameras, problems)
        tracks = [tuple[StoredFrame, ...](frames) for frames in found]
    else:
        tracks = [
            tuple[StoredFrame, ...](find_exr_frames(folder, camera, problems)) for camera in manifest.cameras
        ]
    return Recording(
        folder=folder,
        manifest=manifest,
        tracks=tuple(
            Track(camera=camera, frames=frames)
            for camera, frames in zip(manifest.cameras, tracks, strict=True)
        ),
        problems=tuple(problems),
    )
