from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from structlog.testing import capture_logs

from nearfield_server.errors import AssetError
from nearfield_server.geometry import cache
from nearfield_server.records import CameraModel, LightSettings, RoomMesh
from nearfield_server.scene.room_config import RoomConfig
from nearfield_server.scene.room_model import export_room_glb


@pytest.fixture
def room(tmp_path: Path, furnished_room: RoomMesh, cameras: tuple[CameraModel, ...]) -> RoomConfig:
    # The underside of the table is black: no camera sees it, and it may be a lamp.
    material = furnished_room.face_material.copy()
    material[22:24] = len(furnished_room.materials)
    mesh = replace(
        furnished_room,
        face_material=material,
        materials=(*furnished_room.materials, "lamp"),
        material_albedo=np.concatenate([furnished_room.material_albedo, np.zeros((1, 3))]),
    )
    export_room_glb(mesh, tmp_path / "room.glb")
    return RoomConfig(
        name="test",
        folder=tmp_path,
        model_path=tmp_path / "room.glb",
        cameras=cameras[1:],
        sources=(),
        change_tolerances=(),
        objects=(),
        views=(),
        lights=(),
        light=LightSettings(),
        atlas_size=240,
        frame_rate=30.0,
    )


def assert_equal(first: cache.Geometry, second: cache.Geometry) -> None:
    assert first[-1] is not None
    for one, other in zip(first, second, strict=True):
        assert one is not None
        assert other is not None
        for field in fields(one):
            value, expected = getattr(one, field.name), getattr(other, field.name)
            if isinstance(expected, np.ndarray):
                assert value.dtype == expected.dtype
                np.testing.assert_array_equal(value, expected)
            else:
                assert value == expected
                assert type(value) is type(expected)


def test_second_start_reads_what_the_first_built(
    room: RoomConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = cache.load_or_build(room, cache_dir=tmp_path / "cache")
    assert len(list((tmp_path / "cache").iterdir())) == 5
    for name in ("load_room_mesh", "rasterise_texels", "build_gather_table", "find_hidden_light"):
        monkeypatch.delattr(cache, name)
    parts: list[float] = []
    assert_equal(
        cache.load_or_build(room, cache_dir=tmp_path / "cache", progress=lambda text, p: parts.append(p)),
        built,
    )
    assert parts[-1] == 1.0


def test_that_nothing_is_hidden_is_remembered_too(
    room: RoomConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    searches: list[int] = []
    monkeypatch.setattr(cache, "find_hidden_light", lambda *_: searches.append(1))
    for _ in range(2):
        assert cache.load_or_build(room, cache_dir=tmp_path / "cache")[-1] is None
    assert searches == [1]


def test_another_search_for_hidden_surfaces_is_another_entry(
    room: RoomConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache.load_or_build(room, cache_dir=tmp_path / "cache")
    monkeypatch.setattr(cache.inspect, "getsource", lambda _: "something else")
    cache.load_or_build(room, cache_dir=tmp_path / "cache")
    assert len(list((tmp_path / "cache").glob("hidden-*"))) == 2
    assert len(list((tmp_path / "cache").iterdir())) == 6


def test_anything_that_matters_changes_the_key(room: RoomConfig, tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    cache.load_or_build(room, cache_dir=folder)
    pose = room.cameras[0].world_from_camera.copy()
    pose[0, 3] -= 0.001
    moved = replace(room, cameras=(replace(room.cameras[0], world_from_camera=pose),))
    cache.load_or_build(moved, cache_dir=folder)
    # Mesh and texels do not depend on the cameras.
    assert len(list(folder.iterdir())) == 8
    cache.load_or_build(replace(room, atlas_size=256), cache_dir=folder)
    assert len(list(folder.iterdir())) == 13


@pytest.mark.parametrize("damage", ["truncate", "empty", "garbage"])
def test_broken_entries_are_built_again(room: RoomConfig, tmp_path: Path, damage: str) -> None:
    folder = tmp_path / "cache"
    built = cache.load_or_build(room, cache_dir=folder)
    for file in folder.iterdir():
        data = file.read_bytes()
        file.write_bytes({"truncate": data[: len(data) // 2], "empty": b"", "garbage": b"no archive"}[damage])
    with capture_logs() as logs:
        assert_equal(cache.load_or_build(room, cache_dir=folder), built)
    assert len(logs) == 5
    assert_equal(cache.load_or_build(room, cache_dir=folder), built)


def test_unwritable_folder_costs_only_time(room: RoomConfig, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with capture_logs() as logs:
        cache.load_or_build(room, cache_dir=tmp_path / "file")
    assert {log["event"] for log in logs} >= {"geometry cache not written"}


def test_no_temporary_files_stay(room: RoomConfig, tmp_path: Path) -> None:
    cache.load_or_build(room, cache_dir=tmp_path / "cache")
    assert not list((tmp_path / "cache").glob("*.tmp"))


def test_missing_model_is_an_asset_error(room: RoomConfig, tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="no such file"):
        cache.load_or_build(replace(room, model_path=tmp_path / "none.glb"), cache_dir=tmp_path / "cache")
