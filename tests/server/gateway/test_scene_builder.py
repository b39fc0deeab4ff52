"""From the tiny room of the test data to a description whose files exist."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nearfield_server.bus.messages import room_revision
from nearfield_server.gateway.scene_builder import build_scene
from nearfield_server.scene.room_config import load_room
from nearfield_server.scene.room_model import load_room_mesh

ROOM = Path(__file__).resolve().parents[2] / "data" / "tiny_room"


def test_tiny_room(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NEARFIELD_CACHE_DIR", str(tmp_path))
    room = load_room(ROOM)
    mesh = load_room_mesh(room.model_path, room.atlas_size)
    reports: list[str] = []
    served = build_scene(room, mesh, 1234, num_vals=24, preset="preview", progress=reports.append)
    scene = served.description
    assert scene.room.revision == room_revision(mesh.content_hash)
    assert (scene.room.atlas.texels, scene.settings.num_vals) == (1234, 24)
    assert [light.name for light in scene.lights] == [light.name for light in room.lights]
    assert reports[0] == "room model"
    urls = {scene.room.model_url, *(item.model_url for item in scene.objects)}
    urls |= {url for view in scene.views for url in view.background_urls}
    assert urls == set(served.assets)
    assert all(path.is_file() for path in served.assets.values())
    assert len(scene.views[0].background_urls) == len(room.lights)
    np.testing.assert_array_equal(
        np.array(scene.objects[0].world_from_object).reshape(4, 4), room.objects[0].world_from_object
    )
    low, size = np.array(scene.room.bounds.minimum), np.array(scene.room.bounds.size)
    assert (mesh.positions >= low).all()
    assert (mesh.positions <= low + size + 1e-12).all()


def test_exported_room_has_the_atlas_of_the_mesh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NEARFIELD_CACHE_DIR", str(tmp_path))
    room = load_room(ROOM)
    mesh = load_room_mesh(room.model_path, room.atlas_size)
    path = build_scene(room, mesh, 1, preset="preview").assets["assets/room.glb"]
    again = load_room_mesh(path, room.atlas_size)
    assert again.uv_source == "file"
    np.testing.assert_allclose(
        np.sort(again.uv[again.faces].reshape(-1)), np.sort(mesh.uv[mesh.faces].reshape(-1)), atol=1e-6
    )
