"""From the room file to opened cameras: which source, which picture size, where the lens shows anything."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_calibration.fisheye import unproject
from nearfield_calibration.models import FisheyeIntrinsics
from nearfield_server.capture.exr_sequence import ExrSequence, ExrSequenceSource
from nearfield_server.capture.lab_source import LabCamera, LabSource, Timeline
from nearfield_server.capture.sensor_model import SensorModel
from nearfield_server.capture.source import Source
from nearfield_server.errors import ConfigError
from nearfield_server.scene.bundle import SCENE_FILE, load_bundle
from nearfield_server.scene.room_config import ExrSequenceSourceConfig, LabSourceConfig, RoomConfig


def image_circle(intrinsics: FisheyeIntrinsics) -> NDArray[np.bool_]:
    """Return (height, width) bool: pixels whose centre looks at most `theta_max` away from the axis."""
    columns, rows = np.meshgrid(np.arange(intrinsics.width), np.arange(intrinsics.height))
    return unproject(np.stack([columns, rows], axis=-1), intrinsics)[1]


def load_timeline(room: RoomConfig, name: str) -> Timeline:
    """Return a lighting sequence of the bundle that the room is.

    Raises:
        ConfigError: the room is no bundle, or has no such sequence.
    """
    if not (room.folder / SCENE_FILE).is_file():
        raise ConfigError(
            f"sequence '{name}': room {room.folder} has no {SCENE_FILE}; only bundles hold lighting sequences"
        )
    sequences = {sequence.name: sequence for sequence in load_bundle(room.folder).sequences}
    if name not in sequences:
        raise ConfigError(
            f"{room.folder / SCENE_FILE}: no sequence '{name}'; there are: {', '.join(sequences) or 'none'}"
        )
    return Timeline(weights=sequences[name].weights, frame_rate=sequences[name].fps)


def make_source(room: RoomConfig, camera_index: int, options: dict[str, Any]) -> Source:
    """Build the source of one camera; `open()` is left to the caller.

    Args:
        room: the room file.
        camera_index: position of the camera in it.
        options: `timeline` (name of a lighting sequence) and `sensor` (fields of `SensorModel`), for simulated cameras.

    Raises:
        ConfigError: an option does not fit the room.
    """
    camera, source = room.cameras[camera_index], room.sources[camera_index]
    height, width = camera.intrinsics.height, camera.intrinsics.width
    if isinstance(source, ExrSequenceSourceConfig):
        return ExrSequenceSource(
            ExrSequence(
                camera_id=camera.camera_id,
                folder=source.folder,
                frame_rate=room.frame_rate,
                height=height,
                width=width,
            )
        )
    if not isinstance(source, LabSourceConfig):
        raise ConfigError(f"camera {camera.camera_id}: sources of kind {source.kind} are not built yet")
    scales = np.array(
        [np.asarray(light.radiance) / light.basis_radiance for light in room.lights], np.float64
    )
    sensor = options.get("sensor")
    return LabSource(
        LabCamera(
            camera_id=camera.camera_id,
            basis_files=source.files,
            light_scales=scales.reshape(-1, 3),
            timeline=load_timeline(room, options["timeline"]) if options.get("timeline") else None,
            # Each camera has noise of its own.
            sensor=SensorModel(**{**sensor, "seed": sensor.get("seed", 1) + camera_index})
            if sensor
            else None,
            height=height,
            width=width,
        )
    )
