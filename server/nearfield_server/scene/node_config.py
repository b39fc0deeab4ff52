"""A camera node: another machine whose cameras join a room. Its file (node.toml, format 1), checked and read.

    format = 1
    node = "window"                         # name of this machine; its certificate carries it
    room = "living room"                    # name of the room, as in its room file
    connect = "192.168.10.5:7448"           # `remote.listen` of the room
    certificates = "certificates"           # folder with ca.pem, <node>.pem, <node>.key
    frame_rate = 10.0                       # optional, frames per second asked of the cameras

    [[cameras]]
    id = "cam3"                             # `camera` of the room file's source
    width = 1024                            # of the source, pixels
    height = 1024
    source = { kind = "aravis", ... }       # as in a room file; lab, exr_sequence, aravis or v4l2
    reduce = 1                              # optional: 2 or 4 sends means over so many pixels in each direction
    compression = "zstd"                    # optional: "zstd" | "none", both lossless
    tiles = true                            # optional: send only the tiles of 32 x 32 pixels that changed
    max_rate = 10.0                         # optional, frames per second; frames beyond are left out
    change_tolerance = 0.0                  # optional, as in a room file

    [[lights]]                              # optional: as in the room file, for lab cameras

Paths are relative to the folder of the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from nearfield_server.errors import AssetError
from nearfield_server.scene.device_schema import REMOTE_NAME, AravisSourceTable, V4l2SourceTable
from nearfield_server.scene.room_config import SourceConfig, SwitchableLight, check_unique, source_config
from nearfield_server.scene.room_schema import (
    Address,
    ExrSequenceTable,
    LabSourceTable,
    Side,
    SwitchableLightTable,
    read_table,
)

Rate = Annotated[float, Field(ge=0.5, le=240, allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class NodeCameraTable(_Strict):
    """Table `cameras` of a node file."""

    id: Annotated[str, Field(pattern=REMOTE_NAME)]
    width: Side
    height: Side
    source: Annotated[
        LabSourceTable | ExrSequenceTable | AravisSourceTable | V4l2SourceTable, Field(discriminator="kind")
    ]
    reduce: Literal[1, 2, 4] = 1
    compression: Literal["zstd", "none"] = "zstd"
    tiles: bool = True
    max_rate: Rate | None = None
    change_tolerance: Annotated[float, Field(ge=0, le=0.1, allow_inf_nan=False)] = 0.0

    @model_validator(mode="after")
    def _divisible(self) -> NodeCameraTable:
        if self.width % self.reduce or self.height % self.reduce:
            raise ValueError(
                f"expected a size that reduce = {self.reduce} divides, found {self.width}x{self.height}"
            )
        return self


class NodeTable(_Strict):
    """The whole file."""

    format: Literal[1]
    node: Annotated[str, Field(pattern=REMOTE_NAME)]
    room: Annotated[str, Field(min_length=1, max_length=64)]
    connect: Address
    certificates: Annotated[str, Field(min_length=1)]
    frame_rate: Rate = 10.0
    lights: tuple[SwitchableLightTable, ...] = ()
    cameras: Annotated[tuple[NodeCameraTable, ...], Field(min_length=1, max_length=8)]


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeCamera:
    """A camera of a node.

    Attributes:
        camera_id: its name.
        width: of the source, pixels. height: of the source, pixels.
        source: with files resolved.
        reduce: pixels of the source per pixel sent, in each direction.
        compression: "zstd" or "none".
        tiles: send only what changed.
        max_rate: frames per second, not above the node's frame rate.
        change_tolerance: relative change of a pixel that is not sent.
    """

    camera_id: str
    width: int
    height: int
    source: SourceConfig
    reduce: int
    compression: str
    tiles: bool
    max_rate: float
    change_tolerance: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeConfig:
    """Everything a node file says; see there."""

    node: str
    room: str
    address: str
    certificates: Path
    frame_rate: float
    lights: tuple[SwitchableLight, ...]
    cameras: tuple[NodeCamera, ...]


def load_node(path: str | Path) -> NodeConfig:
    """Read a node file.

    Raises:
        ConfigError: the file is wrong; one line per wrong key.
        AssetError: a file that it names is missing.
    """
    path = Path(path)
    tables: dict[str, type[BaseModel]] = {"cameras": NodeCameraTable, "lights": SwitchableLightTable}
    table = read_table(path, NodeTable, tables)
    check_unique(path, "cameras.id", [camera.id for camera in table.cameras])
    folder = path.parent / table.certificates
    if not folder.is_dir():
        raise AssetError(
            f"{path}:certificates: expected an existing folder, found {table.certificates!r}. "
            f"Make it where the room is with `nearfield certificates node`, and copy ca.pem, {table.node}.pem and its key here."
        )
    return NodeConfig(
        node=table.node,
        room=table.room,
        address=table.connect,
        certificates=folder,
        frame_rate=table.frame_rate,
        lights=tuple(SwitchableLight(**light.model_dump()) for light in table.lights),
        cameras=tuple(
            NodeCamera(
                camera_id=camera.id,
                width=camera.width,
                height=camera.height,
                source=source_config(camera.source, len(table.lights), path, f"cameras[{index}].source"),
                reduce=camera.reduce,
                compression=camera.compression,
                tiles=camera.tiles,
                max_rate=min(camera.max_rate or table.frame_rate, table.frame_rate),
                change_tolerance=camera.change_tolerance,
            )
            for index, camera in enumerate(table.cameras)
        ),
    )
