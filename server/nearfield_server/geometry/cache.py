"""Geometry artefacts on disk, so that a restarted process is ready at once.

Each artefact is one `.npz`, named by a hash of everything it depends on; a change of model, atlas size, camera or format
leads to another name. Files are written under a temporary name and renamed, so readers never see half a file.
"""

from __future__ import annotations

import hashlib
import inspect
import zipfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import structlog

from nearfield_server.cache_root import cache_root
from nearfield_server.errors import AssetError
from nearfield_server.geometry.gather_table import build_gather_table, find_unseen_fill
from nearfield_server.geometry.probes import ProbeRays
from nearfield_server.geometry.texels import rasterise_texels
from nearfield_server.pipeline import hidden_light, hidden_receivers, receiver_patches
from nearfield_server.pipeline.hidden_light import (
    HiddenLight,
    find_hidden_light,
    no_hidden_light,
    texels_without_source,
)
from nearfield_server.records import GatherTable, RoomMesh, TexelGeometry, UnseenFill
from nearfield_server.scene.room_config import RoomConfig
from nearfield_server.scene.room_model import load_room_mesh
from nearfield_server.whole_file import whole_file

_LOGGER = structlog.get_logger(__name__)
# Raised whenever the meaning or the making of an artefact changes.
_FORMAT = "7"
Progress = Callable[[str, float], None]
Geometry = tuple[RoomMesh, TexelGeometry, GatherTable, UnseenFill, HiddenLight | None]
_Record = TypeVar("_Record", RoomMesh, TexelGeometry, GatherTable, UnseenFill, HiddenLight)


def load_or_build(
    room: RoomConfig,
    *,
    cache_dir: Path | None = None,
    progress: Progress | None = None,
    rasteriser: str = "cpu",
) -> Geometry:
    """Mesh, texels, gather table, fill list and hidden surfaces of a room, from the cache where it holds them.

    The hidden surfaces are None where every surface that no camera sees has something to repeat, or lights nothing.

    Args:
        room: room configuration.
        cache_dir: folder of the cache, `cache_root()` when None. A folder that cannot be written only costs time.
        progress: called with a text and the share of work done in [0, 1].
        rasteriser: see `geometry.texels.rasterise_texels`; part of the cache key.

    Raises:
        AssetError: the room model is broken.
        ConfigError: there is no camera.
        GraphicsError: OpenGL was asked for and is not there.
    """
    folder = cache_dir if cache_dir is not None else cache_root()
    report = progress if progress is not None else _ignore
    report("room model", 0.0)
    mesh, texels = load_or_build_texels(room, cache_dir=folder, rasteriser=rasteriser)
    key = _surface_key(room, rasteriser)
    for camera in room.cameras:
        key.update(
            repr(camera.intrinsics).encode() + np.ascontiguousarray(camera.world_from_camera).tobytes()
        )
    table_file = folder / f"gather-{key.hexdigest()[:32]}.npz"
    fill_file = folder / f"fill-{key.hexdigest()[:32]}.npz"
    table, fill = _load(table_file, GatherTable), _load(fill_file, UnseenFill)
    if table is None or fill is None:
        table = build_gather_table(
            mesh, texels, room.cameras, progress=lambda text, part: report(text, 0.2 + 0.6 * part)
        )
        fill = find_unseen_fill(mesh, texels, table)
        _save(table_file, table)
        _save(fill_file, fill)
    report("hidden surfaces", 0.8)
    # Which receivers to trust is a matter of judgement: any change of that code leads to another name without a new format.
    judgement = "".join(map(inspect.getsource, (hidden_light, hidden_receivers, receiver_patches)))
    key.update(fill.texel.tobytes() + fill.source.tobytes() + judgement.encode())
    hidden_file = folder / f"hidden-{key.hexdigest()[:32]}.npz"
    hidden = _load(hidden_file, HiddenLight) or _save(hidden_file, _find_hidden(mesh, texels, fill))
    report("geometry is ready", 1.0)
    return mesh, texels, table, fill, hidden if hidden.num_groups else None


def _find_hidden(mesh: RoomMesh, texels: TexelGeometry, fill: UnseenFill) -> HiddenLight:
    """Hidden surfaces; a record without groups where there are none, so that this too is remembered."""
    unseen = texels_without_source(fill, texels.area.size)
    found = find_hidden_light(mesh, texels, unseen, ProbeRays(mesh, texels)) if unseen.any() else None
    return found if found is not None else no_hidden_light()


def load_or_build_texels(
    room: RoomConfig, *, cache_dir: Path | None = None, rasteriser: str = "cpu"
) -> tuple[RoomMesh, TexelGeometry]:
    """Mesh and texels of a room: what does not depend on cameras. Arguments and errors as for `load_or_build`."""
    folder = cache_dir if cache_dir is not None else cache_root()
    name = _surface_key(room, rasteriser).hexdigest()[:32]
    mesh_file, texel_file = folder / f"mesh-{name}.npz", folder / f"texels-{name}.npz"
    mesh = _load(mesh_file, RoomMesh) or _save(mesh_file, load_room_mesh(room.model_path, room.atlas_size))
    texels = _load(texel_file, TexelGeometry)
    if texels is None:
        texels = _save(texel_file, rasterise_texels(mesh, room.atlas_size, rasteriser=_checked(rasteriser)))
    return mesh, texels


def _surface_key(room: RoomConfig, rasteriser: str) -> hashlib._Hash:
    if not room.model_path.is_file():
        raise AssetError(f"{room.model_path}: no such file.")
    return hashlib.sha256(f"{_FORMAT} {room.atlas_size} {rasteriser}".encode() + room.model_path.read_bytes())


def _ignore(text: str, part: float) -> None:
    """Report nothing."""


def _checked(rasteriser: str) -> Any:
    if rasteriser not in ("auto", "gl", "cpu"):
        raise ValueError(f"rasteriser: expected 'auto', 'gl' or 'cpu', found {rasteriser!r}")
    return rasteriser


def _save(path: Path, record: _Record) -> _Record:
    """Write a record; failure is logged and costs only the next start."""
    arrays: dict[str, Any] = {field.name: np.asarray(getattr(record, field.name)) for field in fields(record)}
    try:
        with whole_file(path) as partial, partial.open("wb") as stream:
            np.savez(stream, **arrays)
    except OSError as error:
        _LOGGER.warning("geometry cache not written", file=str(path), reason=str(error))
    return record


def _load(path: Path, record_type: type[_Record]) -> _Record | None:
    """Read a record, or None when it is not there or broken (it is then built again)."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            values: dict[str, Any] = {field.name: stored[field.name] for field in fields(record_type)}
    except FileNotFoundError:
        return None
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        _LOGGER.warning(
            "geometry cache entry is broken and is built again", file=str(path), reason=str(error)
        )
        return None
    for name, value in values.items():
        if value.ndim == 0:
            values[name] = value.item()
    if record_type is RoomMesh:
        values["materials"] = tuple(str(name) for name in values["materials"])
    if record_type is GatherTable:
        values["camera_shapes"] = tuple(
            (int(height), int(width)) for height, width in values["camera_shapes"]
        )
    return record_type(**values)
