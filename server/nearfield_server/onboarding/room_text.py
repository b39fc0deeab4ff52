"""Room files as text: tables for new cameras, added to what is there without touching a character of it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import tomli_w

from nearfield_calibration.models import FisheyeIntrinsics
from nearfield_server.errors import ConfigError

SourceValue = str | int | float

_NOT_CALIBRATED = (
    "Not calibrated: the lens is guessed from the image circle, the pose is the identity.",
    "Light from this camera is wrong until a calibration has replaced fx to theta_max and world_from_camera.",
)
_HEADER = "# Room file of Nearfield; all keys: server/README.md\n"
_MODEL_REMARK = "# The model: metres, +y up, diffuse albedo in baseColorFactor.\n"
_IDENTITY = "world_from_camera = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedCamera:
    """A camera that is to be written into a room file.

    Attributes:
        camera_id: name in the room.
        lens: guess, with the size of the picture.
        source: keys of its `source` table, `kind` first.
        remarks: lines of comment, such as vendor and model.
    """

    camera_id: str
    lens: FisheyeIntrinsics
    source: Mapping[str, SourceValue]
    remarks: tuple[str, ...] = ()


def _comment(text: str) -> str:
    return "# " + "".join(character if character.isprintable() else " " for character in text) + "\n"


def camera_text(camera: PlannedCamera) -> str:
    """Table of one camera."""
    lens = camera.lens
    numbers = {
        "width": lens.width,
        "height": lens.height,
        "fx": round(lens.fx, 3),
        "fy": round(lens.fy, 3),
        "cx": round(lens.cx, 3),
        "cy": round(lens.cy, 3),
        "theta_max": round(lens.theta_max, 6),
    }
    parts = [
        "[[cameras]]\n",
        *(_comment(remark) for remark in camera.remarks),
        tomli_w.dumps({"id": camera.camera_id}),
        *(_comment(line) for line in _NOT_CALIBRATED),
        tomli_w.dumps(numbers),
        _IDENTITY,
        "[cameras.source]\n",
        tomli_w.dumps(camera.source),
    ]
    return "".join(parts)


def new_room_text(name: str, model: str, frame_rate: float, cameras: Sequence[PlannedCamera]) -> str:
    """A whole room file.

    Args:
        name: of the room.
        model: GLB, relative to the folder of the room file.
        frame_rate: frames per second asked of the cameras.
        cameras: at least one.
    """
    room = tomli_w.dumps({"format": 1, "name": name, "frame_rate": float(frame_rate)})
    header = _HEADER + room + _MODEL_REMARK + tomli_w.dumps({"model": model})
    return "\n".join([header, *(camera_text(camera) for camera in cameras)])


def with_cameras(text: str, cameras: Sequence[PlannedCamera]) -> str:
    """A room file with further cameras at its end; what was there stays as it was, comments and line ends included.

    Raises:
        ConfigError: it is not TOML, or its cameras are written in a form that cannot be added to.
    """
    newline = "\r\n" if "\r\n" in text else "\n"
    added = "\n".join(camera_text(camera) for camera in cameras).replace("\n", newline)
    gap = "" if not text else newline if text.endswith("\n") else 2 * newline
    longer = f"{text}{gap}{added}"
    before, after = _tables(text), _tables(longer)
    expected = (
        [*before.get("cameras", []), *tomllib.loads(added.replace("\r\n", "\n"))["cameras"]]
        if cameras
        else None
    )
    if cameras and after.get("cameras") != expected:
        raise ConfigError("the cameras could not be added at the end of the file; add them by hand")
    return longer


def camera_ids(text: str) -> list[str]:
    """Names of the cameras of a room file.

    Raises:
        ConfigError: it is not TOML.
    """
    cameras = _tables(text).get("cameras", [])
    return [str(camera.get("id", "")) for camera in cameras if isinstance(camera, dict)]


def camera_places(text: str) -> list[str]:
    """Addresses, serial numbers and device paths of the cameras of a room file.

    Raises:
        ConfigError: it is not TOML.
    """
    sources = [
        camera.get("source") for camera in _tables(text).get("cameras", []) if isinstance(camera, dict)
    ]
    return [
        str(source[key])
        for source in sources
        if isinstance(source, dict)
        for key in ("address", "serial", "path")
        if key in source
    ]


def free_camera_id(taken: Sequence[str]) -> str:
    """First of cam0, cam1, ... that is not taken."""
    return next(name for name in (f"cam{number}" for number in range(len(taken) + 1)) if name not in taken)


def _tables(text: str) -> dict[str, list[dict[str, object]]]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(
            f"not valid TOML ({error}); cameras can be added to tables of the form [[cameras]] only"
        ) from error
