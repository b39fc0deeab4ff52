"""Prepared models without what the papers' methods do not have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.benchmark.methods.light import Transfer as TransferForm
from nearfield_server.radiometry.sh import clamped_cosine_coeffs
from nearfield_server.scene.prepared_cache import ensure_prepared
from nearfield_server.scene.prepared_model import PreparedModel, load_prepared, save_prepared
from nearfield_server.scene.room_config import RoomConfig

PRESET: Final = "medium"


def reduced_model(model: PreparedModel, form: TransferForm) -> PreparedModel:
    """A model with less: `shadowed` has neither self-interreflection nor ground shadow, `cosine` no occlusion at all either."""
    if form == "full":
        return model
    nothing: NDArray[np.float64] = np.zeros_like(model.transfer.bounce1)
    shadowed = model.transfer.shadowed
    if form == "cosine":
        shadowed = clamped_cosine_coeffs(model.normals.astype(np.float64))
    transfer = replace(model.transfer, shadowed=shadowed, bounce1=nothing, bounce2=nothing, bounce_ratio=0.0)
    return replace(model, transfer=transfer, ground_shadow=nothing)


def room_with_models(room: RoomConfig, form: TransferForm, folder: Path) -> RoomConfig:
    """The room with the reduced models of all its objects, written into `folder`.

    Raises:
        AssetError: a model cannot be prepared, or the folder cannot be written.
    """
    objects = []
    for item in room.objects:
        prepared = ensure_prepared(item.model_path, PRESET)
        if form != "full":
            path = folder / f"{prepared.stem}-{form}.glb"
            save_prepared(reduced_model(load_prepared(prepared), form), path)
            prepared = path
        objects.append(replace(item, model_path=prepared))
    return replace(room, objects=tuple(objects))
