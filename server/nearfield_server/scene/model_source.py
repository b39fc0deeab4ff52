"""Reads the triangles of a virtual object from any GLB: all primitives of the default scene in one mesh, node transforms applied."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import AssetError
from nearfield_server.scene.gltf import read_primitives

MAX_VERTICES = 2_000_000
MAX_EXTENT = 100.0


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
    primitives = read_primitives(path)
    starts = np.cumsum([0] + [len(p.positions) for p in primitives])
    positions = np.concatenate([p.positions for p in primitives])
    # A zero normal stands for none; it is computed below.
    normals = np.concatenate(
        [np.zeros_like(p.positions) if p.normals is None else p.normals for p in primitives]
    )
    faces = np.concatenate([p.faces.astype(np.int64) + s for p, s in zip(primitives, starts, strict=False)])
    albedos = np.concatenate([np.tile(p.albedo, (len(p.faces), 1)) for p in primitives])
    if len(positions) > MAX_VERTICES:
        raise AssetError(
            f"{path}: expected at most {MAX_VERTICES} vertices, found {len(positions)}. Simplify the model."
        )
    extent = float(np.max(np.ptp(positions, axis=0)))
    if not 0.0 < extent <= MAX_EXTENT:
        raise AssetError(
            f"{path}: expected a size up to {MAX_EXTENT:g} m, found {extent:g} m. glTF lengths are metres, scale the model."
        )
    notes: list[str] = []
    cross = np.cross(
        positions[faces[:, 1]] - positions[faces[:, 0]], positions[faces[:, 2]] - positions[faces[:, 0]]
    )
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    # Slivers below the float32 resolution of their own coordinates have no direction.
    solid = areas > 1e-14 * extent * extent
    if not solid.any():
        raise AssetError(f"{path}: all {len(faces)} faces have zero area. Export the model again.")
    if not solid.all():
        notes.append(f"left out {np.count_nonzero(~solid)} faces without area")
    faces, cross, areas, albedos = faces[solid], cross[solid], areas[solid], albedos[solid]
    normals = _complete_normals(normals, faces, cross, notes)
    if np.ptp(albedos, axis=0).max() > 1e-6:
        notes.append("several material colours, their mean by area is used")
    return SourceModel(
        positions=positions,
        normals=normals,
        faces=faces,
        # A weighted mean of ones can exceed one by rounding.
        albedo=np.clip(np.average(albedos, axis=0, weights=areas), 0.0, 1.0),
        notes=tuple(notes),
    )


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
