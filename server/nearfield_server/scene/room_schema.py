"""The keys of a room file (room.toml, format 1) and their checks.

    format = 1
    name = "living room"
    model = "room.glb"                      # GLB, metres, +y up, front faces counter-clockwise
    atlas_size = 1024                       # optional, 64 to 4096
    frame_rate = 30.0                       # optional, frames per second asked of the cameras

    [light]                                 # optional, see LightSettings
    num_vals = 16                           # 8 to 64
    split_ratio = 0.5                       # optional, (0, 1]; absent = chosen from the atlas
    num_samples = 4096
    kmeans_iterations = 20
    seed = 1

    [[lights]]                              # lights that the virtual lab can switch; order = order of the basis pictures
    name = "lamp"
    radiance = [15.0, 15.0, 15.0]           # W/(sr m^2)
    basis_radiance = 100.0
    weight = 1.0                            # optional, weight at start

    [[cameras]]                             # 1 to 8 fish-eyes
    id = "cam0"
    width = 1024
    height = 1024
    fx = 326.0                              # pixels per radian
    fy = 326.0
    cx = 511.5
    cy = 511.5
    k = [0.0, 0.0, 0.0, 0.0]                # optional
    theta_max = 1.5707963                   # radians
    world_from_camera = [[...], [...], [...], [...]]
    change_tolerance = 0.0                  # optional, 0 to 0.1: smaller relative changes of a pixel are not passed on
    source = { kind = "exr_sequence", folder = "recordings/cam0" }
    # or     { kind = "recording", folder = "..." }: this camera in a folder of `nearfield record`
    # or     { kind = "lab", files = ["cam0_lamp.exr", ...] }, one per light
    # or     { kind = "aravis", ... }, { kind = "v4l2", ... }: real cameras, see device_schema
    # or     { kind = "remote", node = "window", camera = "cam3" }: a camera of another machine, see node_schema

    [remote]                                # optional: the door for camera nodes, needed for sources of kind "remote"
    listen = "192.168.10.5:7448"            # address and port that nodes connect to
    certificates = "certificates"           # folder with ca.pem, service.pem, service.key

    [[objects]]
    name = "bunny"
    model = "bunny.glb"
    albedo = [0.7, 0.7, 0.7]                # linear
    world_from_object = [[...], [...], [...], [...]]

    [[views]]                               # fixed tablet views
    id = "view0"
    width, height, fx, fy, cx, cy           # pinhole, pixels
    world_from_camera = [[...], [...], [...], [...]]
    background = ["view0_lamp.exr", ...]    # optional, one per light; one where there are no lights

Paths are relative to the folder of the room file.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from nearfield_calibration.fisheye import check_intrinsics
from nearfield_calibration.models import FisheyeIntrinsics
from nearfield_server.errors import ConfigError
from nearfield_server.scene.bundle_fields import check_transform
from nearfield_server.scene.device_schema import AravisSourceTable, RemoteSourceTable, V4l2SourceTable

MAX_TOML_BYTES = 4 * 1024 * 1024
# Object names become file names of HTTP paths.
_NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Unit = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


def _port_exists(address: str) -> str:
    if int(address.rpartition(":")[2]) > 65535:
        raise ValueError("expected a port of at most 65535")
    return address


# Host name or IPv4 address, or IPv6 address in brackets, and a port.
Address = Annotated[
    str,
    Field(pattern=r"^([A-Za-z0-9]([A-Za-z0-9.-]{0,252})|\[[0-9A-Fa-f:.]{2,45}\]):[1-9][0-9]{0,4}$"),
    AfterValidator(_port_exists),
]
Side = Annotated[int, Field(ge=1, le=16384, strict=True)]


def _rigid(value: Any) -> Any:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError("expected 4 rows of 4 numbers") from None
    wrong = check_transform(matrix)
    if wrong is not None:
        raise ValueError(f"expected a 4 x 4 rotation and translation (row-major), found {wrong}")
    return value


Row = tuple[Finite, Finite, Finite, Finite]
Transform = Annotated[tuple[Row, Row, Row, Row], BeforeValidator(_rigid)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class LightTable(_Strict):
    """Table `light`."""

    num_vals: Annotated[int, Field(ge=8, le=64)] = 16
    split_ratio: Annotated[float, Field(gt=0, le=1)] | None = None
    num_samples: Annotated[int, Field(ge=64, le=65536)] = 4096
    kmeans_iterations: Annotated[int, Field(ge=1, le=1000)] = 20
    seed: Annotated[int, Field(ge=0)] = 1


class SwitchableLightTable(_Strict):
    """Table `lights`."""

    name: Annotated[str, Field(pattern=_NAME)]
    radiance: tuple[NotNegative, NotNegative, NotNegative]
    basis_radiance: Positive
    weight: NotNegative = 1.0


class LabSourceTable(_Strict):
    """A camera that mixes basis pictures by the light weights."""

    kind: Literal["lab"]
    files: Annotated[tuple[str, ...], Field(min_length=1)]


class ExrSequenceTable(_Strict):
    """A camera that replays a folder of EXR pictures in the order of their names."""

    kind: Literal["exr_sequence"]
    folder: Annotated[str, Field(min_length=1)]


class RecordingTable(_Strict):
    """A camera that replays what `nearfield record` has recorded of the camera of the same id."""

    kind: Literal["recording"]
    folder: Annotated[str, Field(min_length=1)]


class CameraTable(_Strict):
    """Table `cameras`."""

    id: Annotated[str, Field(pattern=_NAME)]
    width: Side
    height: Side
    fx: Positive
    fy: Positive
    cx: Finite
    cy: Finite
    k: tuple[Finite, Finite, Finite, Finite] = (0.0, 0.0, 0.0, 0.0)
    theta_max: Annotated[float, Field(gt=0, le=np.pi)]
    world_from_camera: Transform
    change_tolerance: Annotated[float, Field(ge=0, le=0.1, allow_inf_nan=False)] = 0.0
    source: Annotated[
        LabSourceTable
        | ExrSequenceTable
        | RecordingTable
        | AravisSourceTable
        | V4l2SourceTable
        | RemoteSourceTable,
        Field(discriminator="kind"),
    ]

    @property
    def intrinsics(self) -> FisheyeIntrinsics:
        """The lens."""
        return FisheyeIntrinsics(
            width=self.width,
            height=self.height,
            fx=self.fx,
            fy=self.fy,
            cx=self.cx,
            cy=self.cy,
            k=self.k,
            theta_max=self.theta_max,
        )

    @model_validator(mode="after")
    def _usable_lens(self) -> CameraTable:
        check_intrinsics(self.intrinsics)
        return self


class ObjectTable(_Strict):
    """Table `objects`."""

    name: Annotated[str, Field(pattern=_NAME)]
    model: Annotated[str, Field(min_length=1)]
    albedo: tuple[Unit, Unit, Unit]
    world_from_object: Transform


class ViewTable(_Strict):
    """Table `views`."""

    id: Annotated[str, Field(pattern=_NAME)]
    width: Side
    height: Side
    fx: Positive
    fy: Positive
    cx: Finite
    cy: Finite
    world_from_camera: Transform
    background: tuple[str, ...] = ()


class RemoteTable(_Strict):
    """Table `remote`: where camera nodes join."""

    listen: Address
    certificates: Annotated[str, Field(min_length=1)]


class RoomTable(_Strict):
    """The whole file."""

    format: Literal[1]
    name: Annotated[str, Field(min_length=1, max_length=64)]
    model: Annotated[str, Field(min_length=1)]
    atlas_size: Annotated[int, Field(ge=64, le=4096)] = 1024
    frame_rate: Annotated[float, Field(gt=0, le=240)] = 30.0
    light: LightTable = LightTable()
    lights: tuple[SwitchableLightTable, ...] = ()
    cameras: Annotated[tuple[CameraTable, ...], Field(min_length=1, max_length=8)]
    objects: Annotated[tuple[ObjectTable, ...], Field(max_length=32)] = ()
    views: tuple[ViewTable, ...] = ()
    remote: RemoteTable | None = None


# Names that pydantic puts into the path of an error to say which of several tables it tried.
_SOURCES: dict[str, type[BaseModel]] = {
    "lab": LabSourceTable,
    "exr_sequence": ExrSequenceTable,
    "recording": RecordingTable,
    "aravis": AravisSourceTable,
    "v4l2": V4l2SourceTable,
    "remote": RemoteSourceTable,
}
_Table = TypeVar("_Table", bound=BaseModel)
_TAGS = {*_SOURCES, "linear", "table", "knee", "off", "bracket"}


def read_room_table(path: Path) -> RoomTable:
    """Parse and check a room.toml.

    Raises:
        ConfigError: missing or not TOML, or wrong keys; lists every wrong key, with a suggestion for unknown ones.
    """
    models: dict[str, type[BaseModel]] = {
        "light": LightTable,
        "lights": SwitchableLightTable,
        "cameras": CameraTable,
        "objects": ObjectTable,
        "views": ViewTable,
        "remote": RemoteTable,
    }
    return read_table(path, RoomTable, models)


def read_table(path: Path, model: type[_Table], tables: Mapping[str, type[BaseModel]]) -> _Table:
    """Parse and check a TOML file.

    Args:
        path: the file.
        model: of the whole file.
        tables: of the tables in it, by name; for suggestions.

    Raises:
        ConfigError: missing or not TOML, or wrong keys; lists every wrong key, with a suggestion for unknown ones.
    """
    if not path.is_file():
        raise ConfigError(f"{path}: no such file.")
    if path.stat().st_size > MAX_TOML_BYTES:
        raise ConfigError(f"{path}: expected at most {MAX_TOML_BYTES} bytes, found {path.stat().st_size}.")
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not valid TOML ({error}).") from error
    try:
        return model.model_validate(values)
    except ValidationError as error:
        lines = [f"{path}:{_describe(item, {'': model, **tables})}" for item in error.errors()]
        raise ConfigError("\n".join(lines)) from error


def _describe(item: Any, tables: Mapping[str, type[BaseModel]]) -> str:
    """One line: key, what was expected and found."""
    location = [part for part in item["loc"] if part not in _TAGS]
    key = ""
    for part in location:
        key += f"[{part}]" if isinstance(part, int) else f"{'.' if key else ''}{part}"
    if item["type"] == "extra_forbidden":
        known = _keys_at([part for part in location[:-1] if isinstance(part, str)], tables)
        near = difflib.get_close_matches(str(location[-1]), known, n=1)
        hint = f" Did you mean {near[0]!r}?" if near else f" Known keys: {', '.join(known)}."
        return f"{key}: unknown key.{hint}"
    if item["type"] == "missing":
        return f"{key}: expected a value, found nothing."
    message = str(item["msg"]).removeprefix("Value error, ")
    found = repr(item["input"])
    # A failed check of a whole table would repeat the table.
    shown = (
        ""
        if isinstance(item["input"], dict)
        else f", found {found if len(found) <= 60 else found[:57] + '...'}"
    )
    return f"{key}: {message[:1].lower()}{message[1:]}{shown}."


def _keys_at(names: list[str], tables: Mapping[str, type[BaseModel]]) -> list[str]:
    """Keys known inside the table reached by the given names."""
    if names and names[-1] == "source":
        return sorted({key for model in _SOURCES.values() for key in model.model_fields})
    return list(tables[names[-1] if names else ""].model_fields)
