"""A room as the service sees it: from a room.toml, or from an evaluation bundle (a bundle is a room)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nearfield_calibration.models import PinholeIntrinsics
from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.records import CameraModel, LightSettings, TabletView
from nearfield_server.scene.bundle import SCENE_FILE, Bundle, load_bundle
from nearfield_server.scene.device_schema import AravisSourceTable, RemoteSourceTable, V4l2SourceTable
from nearfield_server.scene.room_schema import (
    ExrSequenceTable,
    LabSourceTable,
    RecordingTable,
    RoomTable,
    read_room_table,
)

ROOM_FILE = "room.toml"
DEFAULT_ATLAS_SIZE = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class LabSourceConfig:
    """A camera of the virtual lab: basis pictures (one file per light), mixed by the light weights."""

    files: tuple[Path, ...]
    kind: Literal["lab"] = "lab"


@dataclass(frozen=True, slots=True, kw_only=True)
class ExrSequenceSourceConfig:
    """A camera that replays the EXR pictures of a folder in the order of their names."""

    folder: Path
    kind: Literal["exr_sequence"] = "exr_sequence"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingSourceConfig:
    """A camera that replays what `nearfield record` has recorded."""

    folder: Path
    kind: Literal["recording"] = "recording"


SourceConfig = (
    LabSourceConfig
    | ExrSequenceSourceConfig
    | RecordingSourceConfig
    | AravisSourceTable
    | V4l2SourceTable
    | RemoteSourceTable
)
SourceTable = (
    LabSourceTable
    | ExrSequenceTable
    | RecordingTable
    | AravisSourceTable
    | V4l2SourceTable
    | RemoteSourceTable
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectConfig:
    """A virtual object: name (safe as a file name), GLB, linear albedo (3,), pose at start (4, 4) float64."""

    name: str
    model_path: Path
    albedo: tuple[float, float, float]
    world_from_object: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class SwitchableLight:
    """A light of the virtual lab.

    Attributes:
        name: identifier.
        radiance: (3,) at weight 1, W/(sr m^2).
        basis_radiance: white radiance of its basis pictures.
        weight: at start.
    """

    name: str
    radiance: tuple[float, float, float]
    basis_radiance: float
    weight: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoteConfig:
    """The door for camera nodes: "host:port" that they connect to, and the folder of the service's certificate."""

    address: str
    certificates: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomConfig:
    """Everything a room file says; paths are absolute or relative to the working directory and exist.

    Attributes:
        name: for people and bus keys.
        folder: of the room file; `TabletView.background_files` are relative to it.
        model_path: room GLB.
        cameras: fish-eyes. sources: one per camera.
        change_tolerances: one per camera; change of a pixel relative to the value in use that is not passed on.
        objects, views, lights: see there.
        light: settings of the light extraction.
        atlas_size: largest side of the atlas, texels.
        frame_rate: frames per second asked of the sources.
        remote: where camera nodes join; None = nowhere.
    """

    name: str
    folder: Path
    model_path: Path
    cameras: tuple[CameraModel, ...]
    sources: tuple[SourceConfig, ...]
    change_tolerances: tuple[float, ...]
    objects: tuple[ObjectConfig, ...]
    views: tuple[TabletView, ...]
    lights: tuple[SwitchableLight, ...]
    light: LightSettings
    atlas_size: int
    frame_rate: float
    remote: RemoteConfig | None = None

    @property
    def remote_nodes(self) -> tuple[str, ...]:
        """Names of the camera nodes that the room knows, sorted."""
        return tuple(sorted({s.node for s in self.sources if isinstance(s, RemoteSourceTable)}))


def load_room(path: str | Path) -> RoomConfig:
    """Read a room.

    Args:
        path: room.toml, scene.json, or a folder with one of them (room.toml first).

    Raises:
        ConfigError: the room file is wrong; one line per wrong key.
        AssetError: a file that it names, or the bundle, is missing or wrong.
    """
    path = Path(path)
    if path.is_dir():
        file = next((path / name for name in (ROOM_FILE, SCENE_FILE) if (path / name).is_file()), None)
        if file is None:
            raise ConfigError(f"{path}: expected {ROOM_FILE} or {SCENE_FILE} in this folder, found neither.")
        path = file
    if not path.is_file():
        raise ConfigError(
            f"{path}: no such room. Give a {ROOM_FILE}, a {SCENE_FILE}, or a folder that holds one."
        )
    if path.suffix == ".json":
        return room_from_bundle(load_bundle(path))
    return _room_from_table(read_room_table(path), path)


def room_from_bundle(bundle: Bundle) -> RoomConfig:
    """The room of an evaluation bundle, all lights at weight 1."""
    return RoomConfig(
        name=bundle.name,
        folder=bundle.folder,
        model_path=bundle.model_path,
        cameras=tuple(camera.model for camera in bundle.cameras),
        sources=tuple(LabSourceConfig(files=camera.files) for camera in bundle.cameras),
        change_tolerances=(0.0,) * len(bundle.cameras),
        objects=tuple(
            ObjectConfig(
                name=item.name,
                model_path=item.model_path,
                albedo=item.albedo,
                world_from_object=item.world_from_object,
            )
            for item in bundle.objects
        ),
        views=tuple(view.model for view in bundle.views),
        lights=tuple(
            SwitchableLight(
                name=light.name, radiance=light.radiance, basis_radiance=light.basis_radiance, weight=1.0
            )
            for light in bundle.lights
        ),
        light=LightSettings(),
        atlas_size=DEFAULT_ATLAS_SIZE,
        frame_rate=30.0,
    )


def _room_from_table(table: RoomTable, file: Path) -> RoomConfig:
    folder = file.parent
    for key in ("lights", "objects"):
        check_unique(file, f"{key}.name", [item.name for item in getattr(table, key)])
    for key in ("cameras", "views"):
        check_unique(file, f"{key}.id", [item.id for item in getattr(table, key)])
    return RoomConfig(
        name=table.name,
        folder=folder,
        model_path=_existing(file, "model", table.model),
        cameras=tuple(
            CameraModel(
                camera_id=camera.id,
                intrinsics=camera.intrinsics,
                world_from_camera=np.array(camera.world_from_camera, dtype=np.float64),
            )
            for camera in table.cameras
        ),
        sources=tuple(_source(table, index, file) for index in range(len(table.cameras))),
        change_tolerances=tuple(camera.change_tolerance for camera in table.cameras),
        objects=tuple(
            ObjectConfig(
                name=item.name,
                model_path=_existing(file, f"objects[{index}].model", item.model),
                albedo=item.albedo,
                world_from_object=np.array(item.world_from_object, dtype=np.float64),
            )
            for index, item in enumerate(table.objects)
        ),
        views=tuple(_view(table, index, file) for index in range(len(table.views))),
        lights=tuple(SwitchableLight(**light.model_dump()) for light in table.lights),
        light=LightSettings(**table.light.model_dump()),
        atlas_size=table.atlas_size,
        frame_rate=table.frame_rate,
        remote=_remote(table, file),
    )


def _remote(table: RoomTable, file: Path) -> RemoteConfig | None:
    sources = [camera.source for camera in table.cameras]
    remote = [(s.node, s.camera) for s in sources if isinstance(s, RemoteSourceTable)]
    check_unique(file, "cameras.source (node, camera)", [f"{node}, {camera}" for node, camera in remote])
    if table.remote is None:
        if remote:
            raise ConfigError(
                f"{file}:remote: expected a table with listen and certificates, because cameras have sources of kind 'remote'; found none."
            )
        return None
    folder = file.parent / table.remote.certificates
    if not folder.is_dir():
        raise AssetError(
            f"{file}:remote.certificates: expected an existing folder, found {table.remote.certificates!r}. "
            "Make it with `nearfield certificates room`."
        )
    return RemoteConfig(address=table.remote.listen, certificates=folder)


def _source(table: RoomTable, index: int, file: Path) -> SourceConfig:
    key = f"cameras[{index}].source"
    return source_config(table.cameras[index].source, len(table.lights), file, key)


def source_config(source: SourceTable, num_lights: int, file: Path, key: str) -> SourceConfig:
    """Resolve the files of a `source` table.

    Args:
        source: the table.
        num_lights: entries of `lights`.
        file: that the table is in; paths are relative to its folder.
        key: of the table, for messages.

    Raises:
        ConfigError: not one basis picture per light.
        AssetError: a file or folder is missing.
    """
    if isinstance(source, ExrSequenceTable | RecordingTable):
        folder = file.parent / source.folder
        if not folder.is_dir():
            raise AssetError(f"{file}:{key}.folder: expected an existing folder, found {source.folder!r}.")
        if isinstance(source, RecordingTable):
            return RecordingSourceConfig(folder=folder)
        return ExrSequenceSourceConfig(folder=folder)
    if isinstance(source, AravisSourceTable | V4l2SourceTable | RemoteSourceTable):
        return source
    _check_one_per_light(num_lights, file, f"{key}.files", source.files)
    return LabSourceConfig(files=tuple(_existing(file, f"{key}.files", name) for name in source.files))


def _view(table: RoomTable, index: int, file: Path) -> TabletView:
    view = table.views[index]
    if view.background:
        # Without switchable lights, as in a real room, one picture of the room as it was.
        count = max(1, len(table.lights))
        _check_one_per_light(count, file, f"views[{index}].background", view.background)
    for name in view.background:
        _existing(file, f"views[{index}].background", name)
    return TabletView(
        view_id=view.id,
        intrinsics=PinholeIntrinsics(
            width=view.width, height=view.height, fx=view.fx, fy=view.fy, cx=view.cx, cy=view.cy
        ),
        world_from_camera=np.array(view.world_from_camera, dtype=np.float64),
        background_files=view.background,
    )


def _check_one_per_light(num_lights: int, file: Path, key: str, names: tuple[str, ...]) -> None:
    if len(names) != num_lights:
        raise ConfigError(
            f"{file}:{key}: expected {num_lights} files (one per entry of lights), found {len(names)}."
        )


def check_unique(file: Path, key: str, names: list[str]) -> None:
    """Raise ConfigError if a name is there twice."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(f"{file}:{key}: expected different values, found {twice} more than once.")


def _existing(file: Path, key: str, name: str) -> Path:
    path = file.parent / name
    if not path.is_file():
        raise AssetError(f"{file}:{key}: expected an existing file, found {name!r}.")
    return path
