"""Hardened reading and writing of binary glTF (GLB): self-contained triangle meshes only.

An own reader, because general loaders round `baseColorFactor` to 8 bit and follow external URIs.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import AssetError
from nearfield_server.scene.gltf_accessors import Buffers

MAX_FILE_BYTES = 512 * 1024 * 1024
MAX_TRIANGLES = 4_000_000
MAX_NODE_DEPTH = 64
_MAGIC, _JSON_CHUNK, _BIN_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
# Extensions that change nothing of what is read here.
_HARMLESS_EXTENSIONS = {"KHR_mesh_quantization", "KHR_materials_unlit", "KHR_materials_emissive_strength"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Primitive:
    """One triangle mesh with one material, in world coordinates.

    Attributes:
        positions: (V, 3) float64 metres.
        normals: (V, 3) float64 unit, or None when the file has none.
        uv: (V, 2) float64, or None when the file has none.
        faces: (F, 3) int32, counter-clockwise from the front.
        material: name. albedo: (3,) exact linear `baseColorFactor`.
    """

    positions: NDArray[np.float64]
    normals: NDArray[np.float64] | None
    uv: NDArray[np.float64] | None
    faces: NDArray[np.int32]
    material: str
    albedo: tuple[float, float, float]


def read_glb_chunks(path: str | Path) -> tuple[dict[str, Any], bytes]:
    """JSON document and binary chunk (empty when absent) of a GLB file.

    Raises:
        AssetError: missing, too large, not GLB version 2, truncated, or not JSON.
    """
    path = Path(path)
    if not path.is_file():
        raise AssetError(f"{path}: no such file.")
    if path.stat().st_size > MAX_FILE_BYTES:
        raise AssetError(f"{path}: expected at most {MAX_FILE_BYTES} bytes, found {path.stat().st_size}.")
    data = path.read_bytes()
    if len(data) < 20:
        raise AssetError(f"{path}: expected a GLB file, found {len(data)} bytes.")
    magic, version, length = struct.unpack_from("<III", data)
    if magic != _MAGIC:
        raise AssetError(f"{path}: not a GLB file (expected it to begin with 'glTF'). Export as glTF binary.")
    if version != 2:
        raise AssetError(f"{path}: expected glTF version 2, found {version}.")
    if length > len(data):
        raise AssetError(
            f"{path}: truncated, header promises {length} bytes, found {len(data)}. Copy it again."
        )
    chunks: dict[int, bytes] = {}
    offset = 12
    while offset + 8 <= length:
        size, kind = struct.unpack_from("<II", data, offset)
        if offset + 8 + size > length:
            raise AssetError(
                f"{path}: chunk at byte {offset} of {size} bytes reaches beyond the file. Copy it again."
            )
        chunks.setdefault(kind, data[offset + 8 : offset + 8 + size])
        offset += 8 + size
    if _JSON_CHUNK not in chunks:
        raise AssetError(f"{path}: no JSON chunk.")
    try:
        document = json.loads(chunks[_JSON_CHUNK])
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise AssetError(f"{path}: JSON chunk is not valid ({error}).") from error
    if not isinstance(document, dict):
        raise AssetError(f"{path}: expected a JSON object, found {type(document).__name__}.")
    return document, chunks.get(_BIN_CHUNK, b"")


def write_glb(path: str | Path, document: dict[str, Any], binary: bytes) -> None:
    """Write a GLB file from its JSON document and binary chunk (buffer 0)."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    header = struct.pack("<III", _MAGIC, 2, total) + struct.pack("<II", len(text), _JSON_CHUNK)
    Path(path).write_bytes(header + text + struct.pack("<II", len(binary), _BIN_CHUNK) + binary)


def read_primitives(path: str | Path) -> tuple[Primitive, ...]:
    """Every triangle primitive of the default scene, node transforms applied.

    Points and lines are left out; emissive factors are never read (light is measured, not modelled).

    Raises:
        AssetError: broken or unsupported file, or no triangle in it; names the file and the glTF path.
    """
    path = Path(path)
    document, binary = read_glb_chunks(path)
    unknown = set(document.get("extensionsRequired", [])) - _HARMLESS_EXTENSIONS
    if unknown:
        raise AssetError(
            f"{path}: needs extensions {sorted(unknown)}. Export without compression and extensions."
        )
    try:
        primitives = _Reader(path, document, binary).read()
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        raise AssetError(
            f"{path}: broken glTF structure ({type(error).__name__}: {error}). Export it again."
        ) from error
    if not primitives:
        raise AssetError(f"{path}: expected at least one triangle, found none. Export the mesh with faces.")
    return primitives


class _Reader:
    def __init__(self, path: Path, document: dict[str, Any], binary: bytes) -> None:
        self._path = path
        self._document = document
        self._buffers = Buffers(path, document, binary)
        self._triangles = 0

    def read(self) -> tuple[Primitive, ...]:
        scenes = self._document.get("scenes")
        nodes = self._document.get("nodes", [])
        if scenes:
            roots = scenes[self._document.get("scene", 0)].get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [index for index in range(len(nodes)) if index not in children]
        found: list[Primitive] = []
        for root in roots:
            self._visit(root, np.eye(4), 0, found)
        return tuple(found)

    def _visit(
        self, index: int, world_from_parent: NDArray[np.float64], depth: int, found: list[Primitive]
    ) -> None:
        if depth > MAX_NODE_DEPTH:
            raise AssetError(
                f"{self._path}:nodes[{index}]: nested deeper than {MAX_NODE_DEPTH}, or a node is its own parent."
            )
        node = self._document["nodes"][index]
        world_from_node = world_from_parent @ self._local(node, index)
        if "mesh" in node:
            where = f"meshes[{node['mesh']}]"
            for number, primitive in enumerate(self._document["meshes"][node["mesh"]]["primitives"]):
                if primitive.get("mode", 4) >= 4:
                    item = self._primitive(primitive, f"{where}.primitives[{number}]", world_from_node)
                    if len(item.faces):
                        found.append(item)
        for child in node.get("children", []):
            self._visit(child, world_from_node, depth + 1, found)

    def _local(self, node: dict[str, Any], index: int) -> NDArray[np.float64]:
        if "matrix" in node:
            matrix = np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
        else:
            x, y, z, w = (float(v) for v in node.get("rotation", (0.0, 0.0, 0.0, 1.0)))
            norm = math.sqrt(x * x + y * y + z * z + w * w) or 1.0
            x, y, z, w = x / norm, y / norm, z / norm, w / norm
            matrix = np.eye(4)
            rotation = np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
                ]
            )
            matrix[:3, :3] = rotation * np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
            matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
        if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-30:
            raise AssetError(
                f"{self._path}:nodes[{index}]: expected an invertible transform, found {matrix.tolist()}."
            )
        return matrix

    def _primitive(
        self, primitive: dict[str, Any], where: str, world_from_node: NDArray[np.float64]
    ) -> Primitive:
        if primitive.get("mode", 4) != 4:
            raise AssetError(
                f"{self._path}:{where}.mode: expected 4 (triangles), found {primitive['mode']}. Triangulate it."
            )
        attributes = primitive["attributes"]
        positions = self._buffers.floats(attributes["POSITION"], 3, f"{where}.POSITION")
        count = len(positions)
        normals = self._optional(attributes, "NORMAL", 3, count, where)
        uv = self._optional(attributes, "TEXCOORD_0", 2, count, where)
        if "indices" in primitive:
            indices = self._buffers.indices(primitive["indices"], count, f"{where}.indices")
        else:
            indices = np.arange(count, dtype=np.int64)
        if len(indices) % 3:
            raise AssetError(f"{self._path}:{where}.indices: expected a multiple of 3, found {len(indices)}.")
        self._triangles += len(indices) // 3
        if self._triangles > MAX_TRIANGLES:
            raise AssetError(f"{self._path}: expected at most {MAX_TRIANGLES} triangles. Simplify the mesh.")
        faces = indices.reshape(-1, 3).astype(np.int32)
        linear = world_from_node[:3, :3]
        if np.linalg.det(linear) < 0:
            # A mirroring node turns counter-clockwise into clockwise.
            faces = np.ascontiguousarray(faces[:, ::-1])
        material, albedo = self._material(primitive.get("material"))
        return Primitive(
            positions=positions @ linear.T + world_from_node[:3, 3],
            normals=None if normals is None else normals @ np.linalg.inv(linear),
            uv=uv,
            faces=faces,
            material=material,
            albedo=albedo,
        )

    def _optional(
        self, attributes: dict[str, Any], name: str, width: int, count: int, where: str
    ) -> NDArray[np.float64] | None:
        if name not in attributes:
            return None
        values = self._buffers.floats(attributes[name], width, f"{where}.{name}")
        if len(values) != count:
            raise AssetError(f"{self._path}:{where}.{name}: expected {count} entries, found {len(values)}.")
        return values

    def _material(self, index: int | None) -> tuple[str, tuple[float, float, float]]:
        if index is None:
            return "default", (1.0, 1.0, 1.0)
        material = self._document["materials"][index]
        factor = material.get("pbrMetallicRoughness", {}).get("baseColorFactor", [1.0, 1.0, 1.0, 1.0])
        albedo = np.array(factor, dtype=np.float64)
        if (
            albedo.shape != (4,)
            or not np.isfinite(albedo).all()
            or (albedo[:3] < 0).any()
            or (albedo[:3] > 1).any()
        ):
            raise AssetError(
                f"{self._path}:materials[{index}].baseColorFactor: expected four numbers in [0, 1], found {factor}."
            )
        return str(material.get("name", f"material{index}")), (
            float(albedo[0]),
            float(albedo[1]),
            float(albedo[2]),
        )
