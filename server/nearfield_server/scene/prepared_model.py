"""Prepared models: a GLB with all that the client needs to light an object (server/ARCHITECTURE.md, Prepared model)."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import AssetError
from nearfield_server.scene.glb_writer import GlbWriter
from nearfield_server.scene.gltf import read_glb_chunks
from nearfield_server.scene.gltf_accessors import Buffers
from nearfield_server.scene.occlusion_field import MAX_RESOLUTION, NUM_CHANNELS, OcclusionField
from nearfield_server.scene.shadow_proxy import ShadowProxy
from nearfield_server.scene.transfer import Transfer
from nearfield_server.whole_file import whole_file

FORMAT_VERSION = 2
"""Of `extras.nearfield`; part of the cache key, so a change makes cached models be prepared again."""

_TRANSFER_ATTRIBUTES = ("_SHADOWED", "_BOUNCE1", "_BOUNCE2", "_GROUND")


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedModel:
    """A virtual object with everything that was computed beforehand, object axes, metres.

    Attributes:
        positions: (V, 3) float32. normals: (V, 3) float32 unit. faces: (F, 3) int32.
        albedo: (3,) float64 linear, of the material; a room file may override it.
        transfer: coefficients per vertex.
        ground_shadow: (V, 9) float64, subtracted from the transfer where the object stands on a surface, times its reflectance.
        proxy: decimated mesh for shadow maps.
        occlusion_field: what the object blocks, seen from around it.
        centre: (3,) float64, centre of the bounding sphere. radius: of it.
        preset: sampling quality. source_hash: SHA-256 of the file that was prepared.
    """

    positions: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.int32]
    albedo: NDArray[np.float64]
    transfer: Transfer
    ground_shadow: NDArray[np.float64]
    proxy: ShadowProxy
    occlusion_field: OcclusionField
    centre: NDArray[np.float64]
    radius: float
    preset: str
    source_hash: str


def save_prepared(model: PreparedModel, path: str | Path) -> None:
    """Write a prepared model; the file appears whole or not at all.

    Raises:
        AssetError: the folder cannot be written.
    """
    path = Path(path)
    data = _encode(model)
    try:
        with whole_file(path) as partial:
            partial.write_bytes(data)
    except OSError as error:
        raise AssetError(
            f"{path}: cannot be written ({error.strerror}); choose another folder with -o"
        ) from error


def load_prepared(path: str | Path) -> PreparedModel:
    """Read a prepared model.

    Raises:
        AssetError: not a GLB, not prepared, of another version, or inconsistent.
    """
    path = Path(path)
    document, binary = read_glb_chunks(path)
    extras = document.get("extras")
    info = extras.get("nearfield") if isinstance(extras, dict) else None
    if not isinstance(info, dict):
        raise AssetError(f"{path}: is not a prepared model; run `nearfield prepare {path}`")
    if info.get("version") != FORMAT_VERSION:
        raise AssetError(
            f"{path}: prepared in format {info.get('version')!r}, this version reads {FORMAT_VERSION}; run `nearfield prepare` "
            f"on the original model"
        )
    try:
        return _decode(path, document, binary, info)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise AssetError(
            f"{path}: prepared data is incomplete ({error!r}); run `nearfield prepare` on the original model"
        ) from error


def source_hash(path: str | Path) -> str:
    """SHA-256 of a file, hexadecimal.

    Raises:
        AssetError: it cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise AssetError(f"{path}: cannot be read ({error.strerror}); check the path") from error


def _encode(model: PreparedModel) -> bytes:
    writer = GlbWriter()
    document = writer.document
    attributes = {
        "POSITION": writer.add_vectors(model.positions),
        "NORMAL": writer.add_vectors(model.normals),
    }
    transfer = model.transfer
    tables = (transfer.shadowed, transfer.bounce1, transfer.bounce2, model.ground_shadow)
    for name, table in zip(_TRANSFER_ATTRIBUTES, tables, strict=True):
        for part in range(3):
            attributes[f"{name}_{part}"] = writer.add_vectors(table[:, 3 * part : 3 * part + 3])
    primitive = {
        "attributes": attributes,
        "indices": writer.add_indices(model.faces),
        "material": 0,
        "mode": 4,
    }
    proxy = {
        "attributes": {"POSITION": writer.add_vectors(model.proxy.positions)},
        "indices": writer.add_indices(model.proxy.faces),
        "mode": 4,
    }
    document["materials"] = [
        {
            "name": "model",
            "pbrMetallicRoughness": {
                "baseColorFactor": [*model.albedo.tolist(), 1.0],
                "metallicFactor": 0.0,
                "roughnessFactor": 1.0,
            },
        }
    ]
    document["meshes"] = [
        {"name": "model", "primitives": [primitive]},
        {"name": "shadow_proxy", "primitives": [proxy]},
    ]
    # Only the model is in the scene, so that ordinary viewers do not show the proxy on top of it.
    document["nodes"] = [{"name": "model", "mesh": 0}, {"name": "shadow_proxy", "mesh": 1}]
    document["scenes"], document["scene"] = [{"nodes": [0]}], 0
    field = model.occlusion_field
    document["extras"] = {
        "nearfield": {
            "version": FORMAT_VERSION,
            "preset": model.preset,
            "source_hash": model.source_hash,
            "centre": model.centre.tolist(),
            "radius": model.radius,
            "bounceRatio": transfer.bounce_ratio,
            "shadowProxyError": model.proxy.hausdorff,
            "occlusionField": {
                "resolution": list(field.resolution),
                "boxMin": field.box_min.tolist(),
                "boxSize": field.box_size.tolist(),
                "bufferView": writer.add_buffer_view(field.coeffs.astype("<f2").tobytes()),
            },
        }
    }
    return writer.to_bytes()


def _decode(path: Path, document: dict[str, Any], binary: bytes, info: dict[str, Any]) -> PreparedModel:
    buffers = Buffers(path, document, binary)
    primitive = document["meshes"][0]["primitives"][0]
    attributes = primitive["attributes"]

    def vectors(name: str) -> NDArray[np.float64]:
        values = buffers.floats(attributes[name], 3, name)
        if len(values) != document["accessors"][attributes["POSITION"]]["count"]:
            raise ValueError(f"{name} has {len(values)} rows")
        return values

    positions = vectors("POSITION")
    shadowed, bounce1, bounce2, ground_shadow = (
        np.concatenate([vectors(f"{name}_{part}") for part in range(3)], axis=1)
        for name in _TRANSFER_ATTRIBUTES
    )
    ratio = float(info["bounceRatio"])
    if not 0.0 <= ratio < 1.0:
        raise ValueError(f"bounceRatio {ratio}")
    material = document["materials"][primitive["material"]]
    proxy_primitive = document["meshes"][1]["primitives"][0]
    proxy_positions = buffers.floats(proxy_primitive["attributes"]["POSITION"], 3, "shadow_proxy")
    proxy = ShadowProxy(
        positions=proxy_positions,
        faces=_faces(buffers, proxy_primitive["indices"], len(proxy_positions)),
        hausdorff=float(info["shadowProxyError"]),
    )
    return PreparedModel(
        positions=positions.astype(np.float32),
        normals=vectors("NORMAL").astype(np.float32),
        faces=_faces(buffers, primitive["indices"], len(positions)),
        albedo=np.asarray(material["pbrMetallicRoughness"]["baseColorFactor"], np.float64)[:3],
        transfer=Transfer(shadowed=shadowed, bounce1=bounce1, bounce2=bounce2, bounce_ratio=ratio),
        ground_shadow=ground_shadow,
        proxy=proxy,
        occlusion_field=_field(document, binary, info["occlusionField"]),
        centre=np.asarray(info["centre"], np.float64).reshape(3),
        radius=float(info["radius"]),
        preset=str(info["preset"]),
        source_hash=str(info["source_hash"]),
    )


def _field(document: dict[str, Any], binary: bytes, info: dict[str, Any]) -> OcclusionField:
    nx, ny, nz = (int(n) for n in info["resolution"])
    if not all(1 <= n <= MAX_RESOLUTION for n in (nx, ny, nz)):
        raise ValueError(f"occlusionField.resolution {info['resolution']}")
    view = document["bufferViews"][info["bufferView"]]
    start = int(view["byteOffset"])
    data = binary[start : start + int(view["byteLength"])]
    coeffs = np.frombuffer(data, "<f2").reshape(nz, ny, nx, NUM_CHANNELS)
    if not np.isfinite(coeffs).all():
        raise ValueError("occlusionField holds values that are not finite")
    return OcclusionField(
        coeffs=coeffs.astype(np.float16),
        box_min=np.asarray(info["boxMin"], np.float64).reshape(3),
        box_size=np.asarray(info["boxSize"], np.float64).reshape(3),
    )


def _faces(buffers: Buffers, index: int, num_vertices: int) -> NDArray[np.int32]:
    return buffers.indices(index, num_vertices, "indices").reshape(-1, 3).astype(np.int32)
