"""Writes the room and the virtual objects as GLB with exact float32 values.

trimesh would quantise baseColorFactor to 8 bit, so the few JSON structures are written here and read back with trimesh in the tests.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xatlas
from numpy.typing import NDArray

from nearfield_server.errors import AssetError
from nearfield_server.virtual_lab.geometry import QUAD_CORNERS, QUAD_TRIANGLES
from nearfield_server.virtual_lab.model import Scene, VirtualObject

_FLOAT, _UINT, _ARRAY_BUFFER, _INDEX_BUFFER = 5126, 5125, 34962, 34963
CHART_PADDING = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomAtlas:
    """UV atlas of the room quads: uv (Q, 4, 2) float64 in [0, 1] per quad corner, and facts for scene.json."""

    uv: NDArray[np.float64]
    width: int
    height: int
    charts: int
    utilization: float
    texels_per_metre: float

    def as_json(self) -> dict[str, Any]:
        """The `uv_atlas` entry of scene.json."""
        return {
            "width": self.width,
            "height": self.height,
            "charts": self.charts,
            "atlases": 1,
            "utilization": self.utilization,
            "texels_per_metre": self.texels_per_metre,
        }


def pack_room(scene: Scene) -> RoomAtlas:
    """Pack every quad as one chart into an atlas of at most `scene.atlas_size` squared, as finely as fits.

    Raises:
        AssetError: xatlas needs more than one atlas at every density tried.
    """
    corners = np.stack([q.p0 + QUAD_CORNERS[:, :1] * q.e1 + QUAD_CORNERS[:, 1:] * q.e2 for q in scene.quads])
    positions = corners.reshape(-1, 3).astype(np.float32)
    normals = np.repeat(np.stack([q.normal for q in scene.quads]), 4, axis=0).astype(np.float32)
    faces = (np.arange(len(corners))[:, None, None] * 4 + QUAD_TRIANGLES).reshape(-1, 3).astype(np.uint32)
    density = float(np.sqrt(scene.atlas_size**2 / sum(q.area for q in scene.quads)))
    for _ in range(60):
        atlas = xatlas.Atlas()
        atlas.add_mesh(positions, faces, normals)
        options = xatlas.PackOptions()
        options.padding, options.texels_per_unit, options.resolution = CHART_PADDING, density, 0
        options.rotate_charts, options.bilinear = True, True
        atlas.generate(xatlas.ChartOptions(), options)
        if atlas.atlas_count == 1 and max(atlas.width, atlas.height) <= scene.atlas_size:
            mapping, _, packed = atlas[0]
            uv = np.empty((len(positions), 2))
            uv[mapping] = packed
            return RoomAtlas(
                uv=uv.reshape(-1, 4, 2),
                width=int(atlas.width),
                height=int(atlas.height),
                charts=int(atlas.chart_count),
                utilization=float(atlas.utilization),
                texels_per_metre=density,
            )
        density *= 0.97
    raise AssetError(
        f"room '{scene.name}': UV charts do not fit into {scene.atlas_size}^2 texels. Raise atlas_size."
    )


class _GlbBuilder:
    def __init__(self) -> None:
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "nearfield virtual lab"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "materials": [],
            "accessors": [],
            "bufferViews": [],
        }
        self._data = bytearray()

    def _accessor(self, values: NDArray[Any], kind: str, target: int) -> int:
        document = self.document
        document["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self._data), "byteLength": values.nbytes, "target": target}
        )
        self._data += values.tobytes()
        component = _FLOAT if values.dtype == np.float32 else _UINT
        entry: dict[str, Any] = {
            "bufferView": len(document["bufferViews"]) - 1,
            "componentType": component,
            "count": len(values),
            "type": kind,
        }
        if kind == "VEC3":
            entry |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        document["accessors"].append(entry)
        return len(document["accessors"]) - 1

    def add(
        self, name: str, material: dict[str, Any], faces: NDArray[np.int32], **attributes: NDArray[np.float64]
    ) -> None:
        """One node with one mesh of one primitive; attributes are POSITION, NORMAL, TEXCOORD_0."""
        document = self.document
        if material not in document["materials"]:
            document["materials"].append(material)
        primitive: dict[str, Any] = {
            "attributes": {
                key: self._accessor(
                    np.ascontiguousarray(value, dtype="<f4"), f"VEC{value.shape[1]}", _ARRAY_BUFFER
                )
                for key, value in attributes.items()
            },
            "indices": self._accessor(
                np.ascontiguousarray(faces, dtype="<u4").ravel(), "SCALAR", _INDEX_BUFFER
            ),
            "material": document["materials"].index(material),
            "mode": 4,
        }
        document["meshes"].append({"name": name, "primitives": [primitive]})
        document["nodes"].append({"name": name, "mesh": len(document["meshes"]) - 1})
        document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)

    def write(self, path: Path) -> None:
        self.document["buffers"] = [{"byteLength": len(self._data)}]
        text = json.dumps(self.document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        data = bytes(self._data) + b"\0" * (-len(self._data) % 4)
        total = 12 + 8 + len(text) + 8 + len(data)
        header = struct.pack("<4sIIII", b"glTF", 2, total, len(text), 0x4E4F534A)
        path.write_bytes(header + text + struct.pack("<II", len(data), 0x004E4942) + data)


def _material(name: str, albedo: tuple[float, float, float]) -> dict[str, Any]:
    return {
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*albedo, 1.0],
            "metallicFactor": 0.0,
            "roughnessFactor": 1.0,
        },
        "doubleSided": False,
    }


def write_room_glb(scene: Scene, atlas: RoomAtlas, path: Path) -> None:
    """Write the real geometry, one primitive per material and one per emitter.

    Emitters carry their nominal radiance as emissiveFactor times KHR_materials_emissive_strength, for reference only.
    """
    builder = _GlbBuilder()
    groups: dict[tuple[str, int], list[int]] = {}
    for index, q in enumerate(scene.quads):
        groups.setdefault((q.material, q.light), []).append(index)
    for (name, light), indices in groups.items():
        quads = [scene.quads[i] for i in indices]
        material = _material(name, scene.materials[name])
        if light >= 0:
            radiance = scene.lights[light].radiance
            strength = max(radiance)
            material["emissiveFactor"] = [value / strength for value in radiance]
            material["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
            builder.document["extensionsUsed"] = ["KHR_materials_emissive_strength"]
        builder.add(
            name if light < 0 else f"{name}__light{light}",
            material,
            (np.arange(len(quads), dtype=np.int32)[:, None, None] * 4 + QUAD_TRIANGLES).reshape(-1, 3),
            POSITION=np.concatenate(
                [q.p0 + QUAD_CORNERS[:, :1] * q.e1 + QUAD_CORNERS[:, 1:] * q.e2 for q in quads]
            ),
            NORMAL=np.repeat(np.stack([q.normal for q in quads]), 4, axis=0),
            TEXCOORD_0=atlas.uv[indices].reshape(-1, 2),
        )
    builder.write(path)


def write_object_glb(item: VirtualObject, path: Path) -> None:
    """Write one virtual object in its local frame with smooth vertex normals."""
    builder = _GlbBuilder()
    builder.add(
        item.name, _material(item.name, item.albedo), item.faces, POSITION=item.positions, NORMAL=item.normals
    )
    builder.write(path)
