"""The reconstructed room: GLB in, mesh with a proper atlas layout out."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import structlog
import xatlas
from numpy.typing import NDArray

from nearfield_server.errors import AssetError
from nearfield_server.records import RoomMesh
from nearfield_server.scene.gltf import Primitive, read_primitives, write_glb
from nearfield_server.scene.uv_raster import cover_texels

_LOGGER = structlog.get_logger(__name__)
# A triangle is degenerate when twice its area is below this share of its longest edge squared (float32 rounding of the file).
_FLAT = 1e-7
# Texels between charts: two of gutter on either side.
_CHART_PADDING = 4
_MAX_EXTENT = 1e4


def load_room_mesh(glb_path: str | Path, atlas_size: int = 1024) -> RoomMesh:
    """Read the room and make sure that its UVs are an atlas.

    The UVs of the file are used when every triangle has some and no two charts overlap; otherwise the mesh is unwrapped
    with xatlas and vertices are duplicated along chart borders. Emissive factors are never read.

    Args:
        glb_path: GLB, metres, +y up.
        atlas_size: texels along the longer side of the atlas that the layout is checked (or made) for.

    Raises:
        AssetError: broken file, no triangle of positive area, or an extent that cannot be a room.
    """
    path = Path(glb_path)
    merged = _merge(read_primitives(path), path)
    positions, normals, uv, faces, face_material = _drop_flat(*merged[:5], path)
    names, albedo = merged[5], merged[6]
    uv_source = "file"
    if uv is None or not _is_atlas(uv, faces, atlas_size):
        positions, normals, uv, faces = _unwrap(positions, normals, faces, atlas_size, path)
        uv_source = "xatlas"
        positions, normals, uv, faces, face_material = _drop_unmapped(
            positions, normals, uv, faces, face_material, path
        )
    digest = hashlib.sha256()
    for array in (positions, normals, uv, faces, face_material, albedo):
        digest.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    return RoomMesh(
        positions=positions,
        normals=normals,
        uv=uv,
        faces=faces,
        face_material=face_material,
        materials=names,
        material_albedo=albedo,
        uv_source=uv_source,
        content_hash=digest.hexdigest(),
    )


def export_room_glb(mesh: RoomMesh, path: str | Path) -> None:
    """Write the mesh with its final UVs, one primitive per material and exact albedo.

    The client draws this file, so that its texture coordinates are those of the atlas.
    """
    parts: list[bytes] = []
    accessors: list[dict[str, Any]] = []
    views: list[dict[str, Any]] = []
    primitives: list[dict[str, Any]] = []

    def add(array: NDArray[Any], kind: str, component: int, target: int, limits: bool = False) -> int:
        offset = sum(len(part) for part in parts)
        parts.append(array.tobytes())
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": target})
        accessor: dict[str, Any] = {
            "bufferView": len(views) - 1,
            "componentType": component,
            "count": len(array),
            "type": kind,
        }
        if limits:
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        accessors.append(accessor)
        return len(accessors) - 1

    for material in range(len(mesh.materials)):
        faces = mesh.faces[mesh.face_material == material]
        if not len(faces):
            continue
        used, local = np.unique(faces, return_inverse=True)
        attributes = {
            "POSITION": add(mesh.positions[used].astype("<f4"), "VEC3", 5126, 34962, limits=True),
            "NORMAL": add(mesh.normals[used].astype("<f4"), "VEC3", 5126, 34962),
            "TEXCOORD_0": add(mesh.uv[used].astype("<f4"), "VEC2", 5126, 34962),
        }
        indices = add(local.reshape(-1).astype("<u4"), "SCALAR", 5125, 34963)
        primitives.append({"attributes": attributes, "indices": indices, "material": material, "mode": 4})
    materials = [
        {
            "name": name,
            "pbrMetallicRoughness": {
                "baseColorFactor": [*map(float, albedo), 1.0],
                "metallicFactor": 0.0,
                "roughnessFactor": 1.0,
            },
        }
        for name, albedo in zip(mesh.materials, mesh.material_albedo, strict=True)
    ]
    binary = b"".join(parts)
    document = {
        "asset": {"version": "2.0", "generator": "nearfield"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "room"}],
        "meshes": [{"primitives": primitives, "name": "room"}],
        "materials": materials,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    write_glb(path, document, binary)


_Merged = tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64] | None,
    NDArray[np.int32],
    NDArray[np.int32],
    tuple[str, ...],
    NDArray[np.float64],
]


def _merge(primitives: tuple[Primitive, ...], path: Path) -> _Merged:
    """All primitives in one mesh; materials with equal name and albedo become one."""
    keys = list(dict.fromkeys((item.material, item.albedo) for item in primitives))
    starts = np.cumsum([0] + [len(item.positions) for item in primitives])
    positions = np.concatenate([item.positions for item in primitives])
    if not np.isfinite(positions).all() or np.abs(positions).max() > _MAX_EXTENT:
        raise AssetError(
            f"{path}: expected coordinates within {_MAX_EXTENT:g} m of the origin. Is the model in metres?"
        )
    faces = np.concatenate([item.faces + start for item, start in zip(primitives, starts, strict=False)])
    normals = np.concatenate(
        [_usable_normals(item.positions, item.faces, item.normals) for item in primitives]
    )
    uv = None
    if all(item.uv is not None for item in primitives):
        uv = np.concatenate([np.asarray(item.uv, dtype=np.float64) for item in primitives])
    face_material = np.concatenate(
        [np.full(len(item.faces), keys.index((item.material, item.albedo)), np.int32) for item in primitives]
    )
    albedo = np.array([albedo for _, albedo in keys], dtype=np.float64)
    return (
        positions,
        normals,
        uv,
        faces.astype(np.int32),
        face_material,
        tuple(name for name, _ in keys),
        albedo,
    )


def _usable_normals(
    positions: NDArray[np.float64], faces: NDArray[np.int32], normals: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Unit vertex normals: those of the file, replaced by area-weighted ones where missing or zero."""
    corners = positions[faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    summed = np.zeros_like(positions)
    for corner in range(3):
        np.add.at(summed, faces[:, corner], crosses)
    if normals is not None:
        given = np.linalg.norm(normals, axis=1) > 1e-6
        summed = np.where(given[:, None], normals, summed)
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    fallback = np.array([0.0, 1.0, 0.0])
    return np.where(length > 0, summed / np.where(length > 0, length, 1.0), fallback)


def _double_areas(
    points: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Twice the area and the longest edge squared of each triangle, in the units of `points` (V, 2 or 3)."""
    corners = points[faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    third = second - first
    squares = np.stack([(edge * edge).sum(axis=1) for edge in (first, second, third)])
    if points.shape[1] == 2:
        doubled = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    else:
        doubled = np.linalg.norm(np.cross(first, second), axis=1)
    return doubled, squares.max(axis=0)


_Parts = tuple[
    NDArray[np.float64], NDArray[np.float64], NDArray[np.float64] | None, NDArray[np.int32], NDArray[np.int32]
]


def _drop_flat(
    positions: NDArray[np.float64],
    normals: NDArray[np.float64],
    uv: NDArray[np.float64] | None,
    faces: NDArray[np.int32],
    face_material: NDArray[np.int32],
    path: Path,
) -> _Parts:
    doubled, longest = _double_areas(positions, faces)
    keep = (doubled > _FLAT * longest) & (longest > 0)
    if not keep.any():
        raise AssetError(f"{path}: expected triangles of positive area, found none among {len(faces)}.")
    if not keep.all():
        _LOGGER.warning(
            "triangles without area left out", file=str(path), left_out=int((~keep).sum()), of=len(faces)
        )
    return (
        positions,
        normals,
        uv,
        np.ascontiguousarray(faces[keep]),
        np.ascontiguousarray(face_material[keep]),
    )


def _is_atlas(uv: NDArray[np.float64], faces: NDArray[np.int32], atlas_size: int) -> bool:
    """Whether all triangles have UV area inside [0, 1] and no two of them overlap."""
    used = uv[faces]
    if used.min() < -1e-6 or used.max() > 1 + 1e-6:
        return False
    doubled, _ = _double_areas(uv, faces)
    if not (doubled > 0).all():
        return False
    return cover_texels(uv, faces, atlas_size, atlas_size).num_overlaps == 0


def _unwrap(
    positions: NDArray[np.float64],
    normals: NDArray[np.float64],
    faces: NDArray[np.int32],
    atlas_size: int,
    path: Path,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
    """New UVs in one atlas; smaller texel densities are tried until all charts fit on one page."""
    centred = (positions - positions.mean(axis=0)).astype(np.float32)
    doubled, _ = _double_areas(positions, faces)
    density = float(np.sqrt(0.85 * atlas_size**2 / (0.5 * doubled.sum())))
    for _ in range(24):
        atlas = xatlas.Atlas()
        atlas.add_mesh(centred, faces.astype(np.uint32), normals.astype(np.float32))
        options = xatlas.PackOptions()
        options.resolution = atlas_size
        options.padding = _CHART_PADDING
        options.texels_per_unit = density
        options.create_image = False
        atlas.generate(xatlas.ChartOptions(), options)
        if atlas.atlas_count == 1:
            mapping, indices, uv = atlas[0]
            mapping = np.asarray(mapping, dtype=np.int64)
            extent = np.array([atlas.width, atlas.height], dtype=np.float64)
            # Square texels: the page is placed in the top-left corner of the square atlas without stretching.
            scaled = np.asarray(uv, dtype=np.float64) * extent / max(float(extent.max()), atlas_size)
            return (
                positions[mapping],
                normals[mapping],
                scaled,
                np.asarray(indices, dtype=np.int32).reshape(-1, 3),
            )
        density *= 0.94
    raise AssetError(
        f"{path}: the charts do not fit into an atlas of {atlas_size} texels. Use a larger atlas_size."
    )


def _drop_unmapped(
    positions: NDArray[np.float64],
    normals: NDArray[np.float64],
    uv: NDArray[np.float64],
    faces: NDArray[np.int32],
    face_material: NDArray[np.int32],
    path: Path,
) -> tuple[
    NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]
]:
    doubled, _ = _double_areas(uv, faces)
    keep = doubled > 0
    if not keep.all():
        _LOGGER.warning(
            "triangles without place in the atlas left out", file=str(path), left_out=int((~keep).sum())
        )
    return (
        positions,
        normals,
        uv,
        np.ascontiguousarray(faces[keep]),
        np.ascontiguousarray(face_material[keep]),
    )
