"""A recording is a room: `room.toml` and all files that it names, so that it can be served anywhere as it was recorded."""

from __future__ import annotations

import re
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import tomli_w

from nearfield_server.bus.messages import ControlState
from nearfield_server.scene.room_config import ROOM_FILE, ObjectConfig, RoomConfig
from nearfield_server.whole_file import whole_file

FILES_FOLDER: Final = "room"
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9_.-]")


def resolve_room(room: RoomConfig, options: dict[str, Any], state: ControlState | None) -> RoomConfig:
    """The room as it is at this moment: settings of the command line, and what users have moved and dimmed."""
    changes = {name: options[name] for name in ("num_vals", "split_ratio") if options.get(name) is not None}
    room = replace(
        room,
        light=replace(room.light, **changes),
        frame_rate=float(options.get("frame_rate") or room.frame_rate),
    )
    if state is None:
        return room
    return replace(
        room,
        lights=tuple(
            replace(light, weight=weight)
            for light, weight in zip(room.lights, state.light_weights, strict=True)
        ),
        objects=tuple(
            replace(item, world_from_object=placement.world_from_object)
            for item, placement in zip(room.objects, state.objects, strict=True)
        ),
    )


def write_snapshot(folder: Path, room: RoomConfig, camera_ids: tuple[str, ...]) -> None:
    """Put `room.toml` and copies of the room's files into the folder of a recording.

    Args:
        folder: of the recording.
        room: to be copied.
        camera_ids: names of the recorded cameras.

    Raises:
        OSError: a file cannot be read or written.
    """
    files = folder / FILES_FOLDER
    files.mkdir(parents=True, exist_ok=True)

    def keep(source: Path, name: str) -> str:
        target = files / name
        if not target.exists():
            with whole_file(target) as partial:
                shutil.copyfile(source, partial)
        return f"{FILES_FOLDER}/{name}"

    values: dict[str, Any] = {
        "format": 1,
        "name": room.name[:64],
        "model": keep(room.model_path, "room.glb"),
        "atlas_size": room.atlas_size,
        "frame_rate": room.frame_rate,
        "light": {name: value for name, value in asdict(room.light).items() if value is not None},
        "lights": [
            {
                "name": name,
                "radiance": list(light.radiance),
                "basis_radiance": light.basis_radiance,
                "weight": light.weight,
            }
            for name, light in zip(
                safe_names([light.name for light in room.lights]), room.lights, strict=True
            )
        ],
        "cameras": [_camera(room, index, camera_id) for index, camera_id in enumerate(camera_ids)],
        "objects": [
            _object(item, name, keep(item.model_path, f"object_{name}.glb"))
            for name, item in zip(safe_names([item.name for item in room.objects]), room.objects, strict=True)
        ],
        "views": [],
    }
    for name, view in zip(safe_names([view.view_id for view in room.views]), room.views, strict=True):
        lens = view.intrinsics
        values["views"].append(
            {
                "id": name,
                **{key: getattr(lens, key) for key in ("width", "height", "fx", "fy", "cx", "cy")},
                "world_from_camera": view.world_from_camera.tolist(),
                "background": [
                    keep(room.folder / file, f"view_{name}_light{index}.exr")
                    for index, file in enumerate(view.background_files)
                ],
            }
        )
    filled = {key: value for key, value in values.items() if value != []}
    with whole_file(folder / ROOM_FILE, is_durable=True) as partial:
        partial.write_bytes(tomli_w.dumps(filled).encode())


def safe_names(names: list[str]) -> list[str]:
    """Different names of the letters that room files allow, as like the given ones as possible."""
    result: list[str] = []
    for name in names:
        plain = _UNSAFE.sub("_", name)[:60]
        plain = plain if plain[:1].isalnum() else f"x{plain}"
        number, unique = 1, plain
        while unique in result:
            number += 1
            unique = f"{plain}_{number}"
        result.append(unique)
    return result


def _camera(room: RoomConfig, index: int, camera_id: str) -> dict[str, Any]:
    camera = room.cameras[index]
    lens = camera.intrinsics
    return {
        "id": camera_id,
        **{key: getattr(lens, key) for key in ("width", "height", "fx", "fy", "cx", "cy")},
        "k": list(lens.k),
        "theta_max": lens.theta_max,
        "world_from_camera": camera.world_from_camera.tolist(),
        # Small changes were left out when it was recorded; leaving out again would change the pictures.
        "change_tolerance": 0.0,
        "source": {"kind": "recording", "folder": "."},
    }


def _object(item: ObjectConfig, name: str, model: str) -> dict[str, Any]:
    return {
        "name": name,
        "model": model,
        "albedo": list(item.albedo),
        "world_from_object": item.world_from_object.tolist(),
    }
