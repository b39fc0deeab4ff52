"""Prepared models on disk: an object is prepared once, and again only when its file changes."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nearfield_server.cache_root import cache_root
from nearfield_server.errors import AssetError
from nearfield_server.scene.gltf import read_glb_chunks
from nearfield_server.scene.prepare import prepare_model
from nearfield_server.scene.prepared_model import FORMAT_VERSION, load_prepared, source_hash


def ensure_prepared(
    glb_path: str | Path, preset: str = "medium", albedo: NDArray[np.floating] | None = None
) -> Path:
    """Path of the prepared form of a model: itself if it is prepared, else from the cache, else prepared now into the cache.

    The cache is keyed by the content of the file, preset, albedo and format, so an
    edited model is prepared anew.

    Args:
        glb_path: any GLB.
        preset: "preview", "medium" or "high".
        albedo: (3,) instead of the material's.

    Raises:
        AssetError: the model cannot be prepared.
    """
    path = Path(glb_path)
    extras = read_glb_chunks(path)[0].get("extras")
    if isinstance(extras, dict) and "nearfield" in extras:
        return path
    colour = (
        "" if albedo is None else "-" + hashlib.sha256(np.asarray(albedo, "<f8").tobytes()).hexdigest()[:8]
    )
    name = f"{path.stem}-{source_hash(path)[:24]}-{preset}{colour}-v{FORMAT_VERSION}.glb"
    cached = cache_root() / "prepared" / name
    if cached.is_file():
        try:
            load_prepared(cached)
        except AssetError:
            cached.unlink(missing_ok=True)
        else:
            return cached
    prepare_model(path, preset, cached, albedo=albedo)
    return cached
