"""A recording is a room: the same as the one that was recorded, on any machine."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.bus.messages import ControlState
from nearfield_server.errors import ServiceError
from nearfield_server.recording.files.manifest import calibration_id, read_manifest
from nearfield_server.recording.folder import begin_take, check_target
from nearfield_server.recording.snapshot import resolve_room, safe_names, write_snapshot
from nearfield_server.records import ObjectPlacement
from nearfield_server.scene.room_config import load_room
from nearfield_server.scene.room_model import load_room_mesh

TINY = Path(__file__).parents[2] / "data" / "tiny_room"


@given(st.lists(st.text(max_size=70), max_size=8))
def test_names_become_safe_and_stay_apart(names: list[str]) -> None:
    safe = safe_names(names)
    assert len(set(safe)) == len(names)
    for name in safe:
        assert name[0].isalnum()
        assert name.isascii()
        assert "/" not in name
    assert safe_names(["cam0", "a.b-c_d"]) == ["cam0", "a.b-c_d"]


def test_the_room_of_a_recording_is_the_room_that_was_recorded(tmp_path: Path) -> None:
    room = load_room(TINY)
    pose = np.eye(4)
    pose[:3, 3] = [0.1, 0.2, 0.3]
    state = ControlState(
        revision=9, light_weights=(0.25, 1.5), objects=(ObjectPlacement(revision=3, world_from_object=pose),)
    )
    now = resolve_room(room, {"num_vals": 24, "frame_rate": 12.5, "split_ratio": None}, state)
    folder = tmp_path / "recording"
    folder.mkdir()
    write_snapshot(folder, replace(now, change_tolerances=(0.01, 0.02)), ("0", "1"))
    # Elsewhere, without the original.
    moved = tmp_path / "elsewhere" / "renamed"
    shutil.copytree(folder, moved)
    shutil.rmtree(folder)
    found = load_room(moved)
    assert load_room_mesh(found.model_path).content_hash == load_room_mesh(room.model_path).content_hash
    assert [calibration_id(camera) for camera in found.cameras] == [
        calibration_id(camera) for camera in room.cameras
    ]
    assert found.light == replace(room.light, num_vals=24)
    assert (found.frame_rate, found.atlas_size, found.name) == (12.5, room.atlas_size, room.name)
    assert [light.weight for light in found.lights] == [0.25, 1.5]
    np.testing.assert_array_equal(found.objects[0].world_from_object, pose)
    assert found.objects[0].model_path.read_bytes() == room.objects[0].model_path.read_bytes()
    assert found.change_tolerances == (0.0, 0.0)
    assert [source.kind for source in found.sources] == ["recording", "recording"]
    for old, new in zip(room.views, found.views, strict=True):
        assert old.intrinsics == new.intrinsics
        for before, after in zip(old.background_files, new.background_files, strict=True):
            assert (room.folder / before).read_bytes() == (found.folder / after).read_bytes()


def test_a_folder_is_for_one_recording_and_its_takes(tmp_path: Path) -> None:
    room = load_room(TINY)
    _, first = begin_take(tmp_path, "raw", room)
    manifest, second = begin_take(tmp_path, "raw", room)
    assert (first.number, second.number) == (1, 2)
    assert [take.number for take in read_manifest(tmp_path).takes] == [1, 2]
    assert manifest == read_manifest(tmp_path)
    with pytest.raises(ServiceError, match="another recording"):
        begin_take(tmp_path, "exr", room)
    with pytest.raises(ServiceError, match="new or empty"):
        check_target(tmp_path)
    other = replace(room.cameras[0], world_from_camera=np.diag([-1.0, -1.0, 1.0, 1.0]))
    with pytest.raises(ServiceError, match="another recording"):
        begin_take(tmp_path, "raw", replace(room, cameras=(other, *room.cameras[1:])))
    check_target(tmp_path / "new" / "folder")
    assert list((tmp_path / "new" / "folder").iterdir()) == []
    (tmp_path / "recording.json").write_text("{")
    with pytest.raises(ServiceError, match="damaged"):
        begin_take(tmp_path, "raw", room)


def test_a_place_that_is_no_folder_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(ServiceError, match="cannot be put there"):
        check_target(tmp_path / "file" / "below")
