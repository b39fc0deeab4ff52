"""From the room file to opened cameras: which source, which picture size, where the lens shows anything."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_calibration.fisheye import unproject
from nearfield_calibration.models import FisheyeIntrinsics
from nearfield_server.capture.darkroom import Darkroom
from nearfield_server.capture.device import Device
from nearfield_server.capture.device_source import DeviceCamera, DeviceSource
from nearfield_server.capture.exr_sequence import ExrSequence, ExrSequenceSource
from nearfield_server.capture.lab_source import LabCamera, LabSource, Timeline
from nearfield_server.capture.recording_source import RecordedCamera, RecordingSource
from nearfield_server.capture.remote.source import RemoteCamera, RemoteSource
from nearfield_server.capture.sensor_model import SensorModel
from nearfield_server.capture.source import Source
from nearfield_server.errors import ConfigError
from nearfield_server.scene.bundle import SCENE_FILE, load_bundle
from nearfield_server.scene.device_schema import AravisSourceTable, RemoteSourceTable, V4l2SourceTable
from nearfield_server.scene.room_config import (
    ExrSequenceSourceConfig,
    RecordingSourceConfig,
    RoomConfig,
    SourceConfig,
    SwitchableLight,
)


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


def make_source(
    room: RoomConfig,
    camera_index: int,
    options: dict[str, Any],
    circle: NDArray[np.bool_] | None = None,
) -> Source:
    """Build the source of one camera of a room; `open()` is left to the caller.

    Args:
        room: the room file.
        camera_index: position of the camera in it.
        options: `frame_rate` (1/s) to ask of devices instead of that of the room file; `timeline` (name of a lighting sequence) and
            `sensor` (fields of `SensorModel`), for simulated cameras; `gate_port` for cameras of other machines; `replay` (`speed`,
            `loop`, and `origin_ns`, see `RecordedCamera`), for recorded ones.
        circle: `image_circle` of the camera, for brackets chosen from the picture; None = everywhere.

    Raises:
        ConfigError: an option does not fit the room.
    """
    camera = room.cameras[camera_index]
    plan = SourcePlan(
        camera_id=camera.camera_id,
        camera_index=camera_index,
        config=room.sources[camera_index],
        height=camera.intrinsics.height,
        width=camera.intrinsics.width,
        frame_rate=room.frame_rate,
        asked_rate=options.get("frame_rate"),
        lights=room.lights,
        timeline=load_timeline(room, options["timeline"]) if options.get("timeline") else None,
        sensor=options.get("sensor"),
        room_name=room.name,
        circle=circle,
        gate_port=int(options.get("gate_port", 0)),
        replay=options.get("replay") or {},
    )
    return build_source(plan)


@dataclass(frozen=True, slots=True, kw_only=True)
class SourcePlan:
    """What a source is made from; room files and the files of camera nodes (several machines) both come down to this.

    Attributes:
        camera_id: name for messages.
        camera_index: position in its file; each simulated camera has noise of its own.
        config: the `source` table.
        height: pixels. width: pixels.
        frame_rate: frames per second, as the file says.
        asked_rate: frames per second to ask of a device instead; None = those of the file.
        lights: switchable lights of a simulated room.
        timeline: lighting sequence that simulated cameras play.
        sensor: fields of `SensorModel` for simulated cameras; None = exact pictures.
        circle: (H, W) bool, where the lens shows anything, for brackets chosen from the picture; None = everywhere.
        room_name: name of the room, for cameras of other machines.
        gate_port: port on loopback where they come in.
        replay: fields of `RecordedCamera` for recorded cameras.
    """

    camera_id: str
    camera_index: int
    config: SourceConfig
    height: int
    width: int
    frame_rate: float
    asked_rate: float | None = None
    lights: tuple[SwitchableLight, ...] = ()
    timeline: Timeline | None = None
    sensor: dict[str, float] | None = None
    circle: NDArray[np.bool_] | None = None
    room_name: str = ""
    gate_port: int = 0
    replay: dict[str, Any] = field(default_factory=dict)


def build_source(plan: SourcePlan) -> Source:
    """Build a source; `open()` is left to the caller."""
    source = plan.config
    if isinstance(source, ExrSequenceSourceConfig):
        return ExrSequenceSource(
            ExrSequence(
                camera_id=plan.camera_id,
                folder=source.folder,
                frame_rate=plan.frame_rate,
                height=plan.height,
                width=plan.width,
            )
        )
    if isinstance(source, RemoteSourceTable):
        return RemoteSource(
            RemoteCamera(
                camera_id=plan.camera_id,
                room=plan.room_name,
                node=source.node,
                camera=source.camera,
                height=plan.height,
                width=plan.width,
                frame_rate=plan.frame_rate,
                gate_port=plan.gate_port,
            )
        )
    if isinstance(source, RecordingSourceConfig):
        return RecordingSource(
            RecordedCamera(
                camera_id=plan.camera_id,
                folder=source.folder,
                height=plan.height,
                width=plan.width,
                **plan.replay,
            )
        )
    if isinstance(source, AravisSourceTable | V4l2SourceTable):
        return _device_source(plan, source)
    scales = np.array(
        [np.asarray(light.radiance) / light.basis_radiance for light in plan.lights], np.float64
    )
    sensor = plan.sensor
    return LabSource(
        LabCamera(
            camera_id=plan.camera_id,
            basis_files=source.files,
            light_scales=scales.reshape(-1, 3),
            timeline=plan.timeline,
            # Each camera has noise of its own.
            sensor=SensorModel(**{**sensor, "seed": sensor.get("seed", 1) + plan.camera_index})  # type: ignore[arg-type]
            if sensor
            else None,
            height=plan.height,
            width=plan.width,
        )
    )


def _device_source(plan: SourcePlan, table: AravisSourceTable | V4l2SourceTable) -> DeviceSource:
    size = plan.width, plan.height
    frame_rate = plan.asked_rate or plan.frame_rate
    device: Device
    # Only processes of such cameras load what speaks to them.
    if isinstance(table, AravisSourceTable):
        from nearfield_server.capture.aravis.device import AravisDevice

        device = AravisDevice(plan.camera_id, table, *size, frame_rate)
    else:
        from nearfield_server.capture.v4l2.device import V4l2Device

        device = V4l2Device(plan.camera_id, table, *size, frame_rate)
    camera = DeviceCamera(
        camera_id=plan.camera_id,
        table=table,
        height=plan.height,
        width=plan.width,
        frame_rate=frame_rate,
    )
    return DeviceSource(camera, device, Darkroom(plan.camera_id, table, *size, plan.circle))
