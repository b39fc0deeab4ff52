"""Reads the triangles of a virtual object from any GLB: all primitives of the default scene in one mesh, node transforms applied."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import AssetError
from nearfield_server.scene.glb_container import Glb, read_glb

MAX_VERTICES = 2_000_000
MAX_FACES = 4_000_000
MAX_EXTENT = 100.0
_DEFAULT_ALBEDO = (0.8, 0.8, 0.8)
_MAX_NODE_DEPTH = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceModel:
    """The triangles of a virtual object, not prepared yet.

    Attributes:
        positions: (V, 3) float64 object frame, metres. normals: (V, 3) float64 unit.
        faces: (F, 3) int64, no face of zero area. albedo: (3,) linear, the area-weighted mean of the materials.
        notes: what had to be mended or left out, in words for the user.
    """

    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    faces: NDArray[np.int64]
    albedo: NDArray[np.float64]
    notes: tuple[str, ...]


def load_source_model(path: str | Path) -> SourceModel:
    """Read a model.

    Raises:
        AssetError: no triangles, non-finite numbers, indices out of range, or beyond the size caps.
    """
    glb = read_glb(path)
    meshes = [_read_primitive(glb, primitive, matrix) for primitive, matrix in _primitives(glb)]
    if not meshes:
        raise AssetError(f"{path}: holds no triangles; export a mesh with faces")
    starts = np.cumsum([0] + [len(m[0]) for m in meshes])
    positions = np.concatenate([m[0] for m in meshes])
    normals = np.concatenate([m[1] for m in meshes])
    faces = np.concatenate([m[2] + start for m, start in zip(meshes, starts, strict=False)])
    albedos = np.concatenate([np.repeat(m[3][None], len(m[2]), axis=0) for m in meshes])
    if len(positions) > MAX_VERTICES or len(faces) > MAX_FACES:
        raise AssetError(
            f"{path}: {len(positions)} vertices and {len(faces)} faces; at most {MAX_VERTICES} and {MAX_FACES}; simplify the model"
        )
    extent = float(np.max(np.ptp(positions, axis=0)))
    if not 0.0 < extent <= MAX_EXTENT:
        raise AssetError(
            f"{path}: is {extent:g} m large, expected up to {MAX_EXTENT:g} m; glTF lengths are metres, scale the model"
        )
    notes: list[str] = []
    cross = np.cross(
        positions[faces[:, 1]] - positions[faces[:, 0]], positions[faces[:, 2]] - positions[faces[:, 0]]
    )
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    # Slivers below the float32 resolution of their own coordinates have no direction.
    solid = areas > 1e-14 * extent * extent
    if not solid.any():
        raise AssetError(f"{path}: all {len(faces)} faces have zero area; export the model again")
    if not solid.all():
        notes.append(f"left out {np.count_nonzero(~solid)} faces without area")
    faces, cross, areas, albedos = faces[solid], cross[solid], areas[solid], albedos[solid]
    normals = _complete_normals(normals, faces, cross, notes)
    if any(
        "baseColorTexture" in m.get("pbrMetallicRoughness", {}) for m in glb.document.get("materials", [])
    ):
        notes.append("colour textures are not used, only baseColorFactor")
    albedo = np.average(albedos, axis=0, weights=areas)
    if np.ptp(albedos, axis=0).max() > 1e-6:
        notes.append("several material colours, their mean by area is used")
    return SourceModel(positions=positions, normals=normals, faces=faces, albedo=albedo, notes=tuple(notes))


def _primitives(glb: Glb) -> list[tuple[dict[str, Any], NDArray[np.float64]]]:
    """Triangle primitives below the default scene's nodes with their object_from_node."""
    document = glb.document
    if document.get("scenes"):
        roots = glb.item("scenes", document.get("scene", 0)).get("nodes", [])
    else:
        roots = list(range(len(document.get("nodes", []))))
    found: list[tuple[dict[str, Any], NDArray[np.float64]]] = []
    stack = [(index, np.eye(4), 0) for index in roots]
    while stack:
        index, parent, depth = stack.pop()
        if depth > _MAX_NODE_DEPTH:
            raise AssetError(
                f"{glb.path}: nodes[{index}] is nested deeper than {_MAX_NODE_DEPTH}; flatten the model"
            )
        node = glb.item("nodes", index)
        matrix = parent @ _node_matrix(glb, node, index)
        if "mesh" in node:
            for primitive in glb.item("meshes", node["mesh"]).get("primitives", []):
                if primitive.get("mode", 4) == 4:
                    found.append((primitive, matrix))
        stack.extend((child, matrix, depth + 1) for child in node.get("children", []))
        if len(found) + len(stack) > 10_000:
            raise AssetError(
                f"{glb.path}: more than 10000 nodes and primitives; join the model into one mesh"
            )
    return found


def _node_matrix(glb: Glb, node: dict[str, Any], index: int) -> NDArray[np.float64]:
    """parent_from_node."""
    try:
        if "matrix" in node:
            matrix = np.asarray(node["matrix"], np.float64).reshape(4, 4).T
        else:
            x, y, z, w = np.asarray(node.get("rotation", (0, 0, 0, 1)), np.float64)
            matrix = np.eye(4)
            matrix[:3, :3] = [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
            matrix[:3, :3] *= np.asarray(node.get("scale", (1, 1, 1)), np.float64)
            matrix[:3, 3] = node.get("translation", (0, 0, 0))
    except (TypeError, ValueError) as error:
        raise AssetError(
            f"{glb.path}: nodes[{index}] has a malformed transform ({error}); export the model again"
        ) from error
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-18:
        raise AssetError(
            f"{glb.path}: nodes[{index}] has a transform without inverse; apply transforms before the export"
        )
    return matrix


def _read_primitive(
    glb: Glb, primitive: dict[str, Any], matrix: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Positions, normals (zero where the file has none), faces and albedo in object axes."""
    attributes = primitive.get("attributes", {})
    if "POSITION" not in attributes:
        raise AssetError(f"{glb.path}: a mesh without POSITION; export the model again")
    positions = glb.accessor(attributes["POSITION"], "VEC3").astype(np.float64)
    if not np.isfinite(positions).all():
        raise AssetError(f"{glb.path}: positions that are not finite; repair the mesh and export it again")
    if "indices" in primitive:
        indices = glb.accessor(primitive["indices"], "SCALAR").astype(np.int64)
    else:
        indices = np.arange(len(positions), dtype=np.int64)
    if len(indices) % 3 or indices.min(initial=0) < 0 or indices.max(initial=0) >= len(positions):
        raise AssetError(
            f"{glb.path}: {len(indices)} indices up to {indices.max(initial=0)} for {len(positions)} vertices do not form "
            f"triangles; the file is broken"
        )
    faces = indices.reshape(-1, 3)
    linear = matrix[:3, :3]
    if np.linalg.det(linear) < 0.0:
        faces = faces[:, ::-1]
    normals = np.zeros_like(positions)
    if "NORMAL" in attributes:
        stored = glb.accessor(attributes["NORMAL"], "VEC3").astype(np.float64)
        if len(stored) == len(positions):
            normals = np.nan_to_num(stored, nan=0.0, posinf=0.0, neginf=0.0) @ np.linalg.inv(linear)
    return positions @ linear.T + matrix[:3, 3], normals, faces, _albedo(glb, primitive)


def _albedo(glb: Glb, primitive: dict[str, Any]) -> NDArray[np.float64]:
    """Linear base colour of a primitive, within [0, 1]."""
    if "material" not in primitive:
        return np.array(_DEFAULT_ALBEDO)
    factor = (
        glb.item("materials", primitive["material"])
        .get("pbrMetallicRoughness", {})
        .get("baseColorFactor", (1.0, 1.0, 1.0, 1.0))
    )
    try:
        albedo = np.asarray(factor, np.float64)[:3]
    except (TypeError, ValueError):
        albedo = np.full(3, np.nan)
    if albedo.shape != (3,) or not np.all((albedo >= 0.0) & (albedo <= 1.0)):
        raise AssetError(
            f"{glb.path}: baseColorFactor {factor!r} is not a colour in [0, 1]; export the model again"
        )
    return albedo


def _complete_normals(
    normals: NDArray[np.float64], faces: NDArray[np.int64], cross: NDArray[np.float64], notes: list[str]
) -> NDArray[np.float64]:
    """Unit normals; area-weighted face normals where the file gives none."""
    length = np.linalg.norm(normals, axis=1)
    missing = length < 1e-6
    used = np.zeros(len(normals), np.bool_)
    used[faces] = True
    if np.any(missing & used):
        notes.append(f"computed {np.count_nonzero(missing & used)} missing normals from the faces")
    computed = np.zeros_like(normals)
    for corner in range(3):
        np.add.at(computed, faces[:, corner], cross)
    result = np.where(missing[:, None], computed, normals)
    length = np.linalg.norm(result, axis=1)
    # Vertices of no face, and those whose faces cancel out, get any direction: nothing is drawn from them.
    result[length < 1e-12] = (0.0, 1.0, 0.0)
    return np.asarray(result / np.linalg.norm(result, axis=1, keepdims=True))
