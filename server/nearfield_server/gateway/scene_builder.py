"""From a room to what clients are told about it, and to the files that they may fetch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.layout import VERSION
from nearfield_server.bus.messages import room_revision
from nearfield_server.cache_root import cache_root
from nearfield_server.errors import AssetError
from nearfield_server.gateway.scene_description import (
    AtlasDescription,
    Bounds,
    LightDescription,
    ObjectDescription,
    RoomDescription,
    SceneDescription,
    SettingsDescription,
    ViewDescription,
)
from nearfield_server.records import RoomMesh
from nearfield_server.scene.prepared_cache import ensure_prepared
from nearfield_server.scene.room_config import RoomConfig
from nearfield_server.scene.room_model import export_room_glb
from nearfield_server.whole_file import whole_file


@dataclass(frozen=True, slots=True, kw_only=True)
class ServedScene:
    """A scene description, the files behind its URLs (`assets/room.glb` -> path), and the names of the room's cameras."""

    description: SceneDescription
    assets: dict[str, Path]
    camera_ids: tuple[str, ...]


def build_scene(
    room: RoomConfig,
    mesh: RoomMesh,
    num_texels: int,
    *,
    num_vals: int | None = None,
    preset: str = "medium",
    progress: Callable[[str], None] | None = None,
) -> ServedScene:
    """Prepare the files of a room and describe it.

    The room model is written out with the UVs of the atlas, objects are prepared; both are cached by content.

    Args:
        room: the room.
        mesh: its model.
        num_texels: covered texels of its atlas.
        num_vals: slots per light packet, None = as the room file says.
        preset: quality of prepared objects.
        progress: told what is being done.

    Raises:
        AssetError: a model or picture is missing or broken, or the cache cannot be written.
    """
    report = progress or (lambda _: None)
    assets: dict[str, Path] = {}
    report("room model")
    assets["assets/room.glb"] = _exported_room(mesh)
    objects = []
    for index, item in enumerate(room.objects):
        report(f"object {item.name}")
        url = f"assets/objects/{item.name}.glb"
        assets[url] = ensure_prepared(item.model_path, preset)
        objects.append(
            ObjectDescription(
                index=index,
                name=item.name,
                model_url=url,
                albedo=item.albedo,
                world_from_object=_row_major(item.world_from_object),
            )
        )
    views = tuple(_view(room, index, assets) for index in range(len(room.views)))
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    x, y, z = (float(value) for value in low)
    # A room without height (a single table top) still needs a box with one.
    sx, sy, sz = (float(value) for value in np.maximum(high - low, 1e-3))
    description = SceneDescription(
        protocol_version=VERSION,
        room=RoomDescription(
            name=room.name,
            model_url="assets/room.glb",
            revision=room_revision(mesh.content_hash),
            atlas=AtlasDescription(width=room.atlas_size, height=room.atlas_size, texels=num_texels),
            bounds=Bounds(minimum=(x, y, z), size=(sx, sy, sz)),
        ),
        objects=tuple(objects),
        views=views,
        lights=tuple(
            LightDescription(
                index=index,
                name=light.name,
                radiance=light.radiance,
                basis_radiance=light.basis_radiance,
                weight=light.weight,
            )
            for index, light in enumerate(room.lights)
        ),
        settings=SettingsDescription(num_vals=num_vals or room.light.num_vals),
    )
    camera_ids = tuple(camera.camera_id for camera in room.cameras)
    return ServedScene(description=description, assets=assets, camera_ids=camera_ids)


def _exported_room(mesh: RoomMesh) -> Path:
    path = cache_root() / "rooms" / f"room-{mesh.content_hash[:32]}.glb"
    if path.is_file():
        return path
    try:
        # Another gateway may look for the file at this moment.
        with whole_file(path) as partial:
            export_room_glb(mesh, partial)
    except OSError as error:
        raise AssetError(
            f"{path}: cannot write the room model ({error.strerror}); set NEARFIELD_CACHE_DIR"
        ) from error
    return path


def _view(room: RoomConfig, index: int, assets: dict[str, Path]) -> ViewDescription:
    view = room.views[index]
    urls = []
    for light, name in enumerate(view.background_files):
        url = f"assets/views/view{index}_light{light}{Path(name).suffix}"
        assets[url] = room.folder / name
        urls.append(url)
    lens = view.intrinsics
    return ViewDescription(
        index=index,
        id=view.view_id,
        width=lens.width,
        height=lens.height,
        fx=lens.fx,
        fy=lens.fy,
        cx=lens.cx,
        cy=lens.cy,
        world_from_camera=_row_major(view.world_from_camera),
        background_urls=tuple(urls),
    )


def _row_major(matrix: NDArray[np.floating[Any]]) -> tuple[float, ...]:
    return tuple(float(value) for value in np.asarray(matrix, np.float64).reshape(16))
