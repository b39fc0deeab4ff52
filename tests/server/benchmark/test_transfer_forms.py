from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nearfield_server.benchmark import transfer_forms
from nearfield_server.benchmark.transfer_forms import reduced_model, room_with_models
from nearfield_server.radiometry.sh import irradiance
from nearfield_server.scene.bundle import load_bundle
from nearfield_server.scene.prepared_model import load_prepared
from nearfield_server.scene.room_config import room_from_bundle

TINY = Path(__file__).parents[2] / "data" / "tiny_room"


def test_models_lose_what_the_form_does_not_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NEARFIELD_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(transfer_forms, "PRESET", "preview")
    room = room_from_bundle(load_bundle(TINY))
    full = load_prepared(room_with_models(room, "full", tmp_path).objects[0].model_path)
    shadowed = load_prepared(room_with_models(room, "shadowed", tmp_path).objects[0].model_path)
    cosine = load_prepared(room_with_models(room, "cosine", tmp_path).objects[0].model_path)
    np.testing.assert_array_equal(shadowed.transfer.shadowed, full.transfer.shadowed)
    for model in (shadowed, cosine):
        np.testing.assert_array_equal(model.transfer.total(np.ones(3))[..., 0], model.transfer.shadowed)
        assert not model.ground_shadow.any()
        np.testing.assert_array_equal(model.positions, full.positions)
    light = np.random.default_rng(2).random((9, 3))
    np.testing.assert_allclose(cosine.transfer.shadowed @ light, irradiance(light, cosine.normals), atol=1e-5)
    assert reduced_model(full, "full") is full
