"""Prepares a virtual object: transfer coefficients, shadow proxy and occlusion field, written into one GLB."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import AssetError
from nearfield_server.scene.ground_shadow import compute_ground_shadow
from nearfield_server.scene.model_source import load_source_model
from nearfield_server.scene.occlusion_field import compute_occlusion_field
from nearfield_server.scene.prepared_model import PreparedModel, save_prepared, source_hash
from nearfield_server.scene.shadow_proxy import make_shadow_proxy
from nearfield_server.scene.transfer import SAMPLES_PER_VERTEX, compute_transfer

DEFAULT_PRESET = "medium"

StageProgress = Callable[[str, int, int], None]


def prepare_model(
    glb_path: str | Path,
    preset: str = DEFAULT_PRESET,
    out: str | Path | None = None,
    *,
    albedo: NDArray[np.floating] | None = None,
    seed: int = 1,
    progress: StageProgress | None = None,
) -> PreparedModel:
    """Compute everything that lighting an object needs beforehand.

    Args:
        glb_path: model in metres, +y up.
        preset: "preview", "medium" or "high" (100, 625, 2500 visibility samples per vertex).
        out: where to write the prepared GLB; None writes nothing.
        albedo: (3,) linear, instead of the material's colour.
        seed: of the sampling pattern; equal input gives equal output.
        progress: called with (stage, done, in all).

    Raises:
        AssetError: the model cannot be read, is unknown to glTF or too large, or the preset or albedo is wrong.
    """
    if preset not in SAMPLES_PER_VERTEX:
        raise AssetError(f"preset {preset!r} does not exist; choose one of {', '.join(SAMPLES_PER_VERTEX)}")
    source = load_source_model(glb_path)
    colour = source.albedo if albedo is None else np.asarray(albedo, np.float64)
    if colour.shape != (3,) or not np.all((colour >= 0.0) & (colour <= 1.0)):
        raise AssetError(
            f"albedo {colour.tolist()} is not three numbers in [0, 1]; give linear red,green,blue"
        )

    def report(stage: str) -> Callable[[int, int], None]:
        return lambda done, total: progress(stage, done, total) if progress is not None else None

    transfer = compute_transfer(
        source.positions,
        source.normals,
        source.faces,
        samples_per_vertex=SAMPLES_PER_VERTEX[preset],
        seed=seed,
        progress=report("transfer"),
    )
    ground_shadow = compute_ground_shadow(
        source.positions,
        source.normals,
        source.faces,
        float(colour.mean()),
        transfer.total(float(colour.mean())),
        samples_per_vertex=SAMPLES_PER_VERTEX[preset],
        seed=seed,
        progress=report("ground shadow"),
    )
    field = compute_occlusion_field(source.positions, source.faces, progress=report("occlusion field"))
    low, high = source.positions.min(axis=0), source.positions.max(axis=0)
    centre = 0.5 * (low + high)
    model = PreparedModel(
        positions=source.positions.astype(np.float32),
        normals=source.normals.astype(np.float32),
        faces=source.faces.astype(np.int32),
        albedo=colour,
        transfer=transfer,
        ground_shadow=ground_shadow,
        proxy=make_shadow_proxy(source.positions, source.faces),
        occlusion_field=field,
        centre=centre,
        radius=float(np.max(np.linalg.norm(source.positions - centre, axis=1))),
        preset=preset,
        source_hash=source_hash(glb_path),
    )
    if out is not None:
        save_prepared(model, out)
    return model
