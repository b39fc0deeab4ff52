"""Room files are written whole, load again, and keep every character that was there."""

from __future__ import annotations

import stat
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_calibration.models import FisheyeIntrinsics
from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.onboarding.lens_guess import default_lens
from nearfield_server.onboarding.room_file import add_cameras, create_room
from nearfield_server.onboarding.room_text import (
    PlannedCamera,
    camera_ids,
    free_camera_id,
    new_room_text,
    with_cameras,
)
from nearfield_server.scene.device_schema import AravisSourceTable, V4l2SourceTable
from nearfield_server.scene.room_config import load_room

TINY_ROOM = Path(__file__).parents[2] / "data" / "tiny_room"


def planned(camera_id: str = "cam0", **source: str | int | float) -> PlannedCamera:
    lens = FisheyeIntrinsics(
        width=640,
        height=480,
        fx=152.7891,
        fy=152.7891,
        cx=318.25,
        cy=241.5,
        k=(0, 0, 0, 0),
        theta_max=1.5707963268,
    )
    table = source or {
        "kind": "aravis",
        "address": "192.168.10.21",
        "pixel_format": "BayerRG12p",
        "exposure_s": 0.01,
    }
    return PlannedCamera(camera_id=camera_id, lens=lens, source=table, remarks=("Maker Eye\n4711",))


@pytest.fixture
def model(tmp_path: Path) -> Path:
    (tmp_path / "models").mkdir()
    copy = tmp_path / "models" / "room.glb"
    copy.write_bytes(next(TINY_ROOM.glob("*.glb")).read_bytes())
    return copy


def test_a_written_room_is_the_room_that_was_planned(tmp_path: Path, model: Path) -> None:
    video = planned("door", kind="v4l2", path="/dev/v4l/by-id/usb-eye", pixel_format="YUYV")
    room = create_room(
        tmp_path / "room.toml", [planned(), video], name='the "lab"', model=model, frame_rate=12.5
    )
    assert (room.name, room.frame_rate, room.model_path.resolve()) == ('the "lab"', 12.5, model.resolve())
    assert [camera.camera_id for camera in room.cameras] == ["cam0", "door"]
    first, second = room.sources
    assert isinstance(first, AravisSourceTable)
    assert (str(first.address), first.pixel_format, first.exposure_s) == ("192.168.10.21", "BayerRG12p", 0.01)
    assert isinstance(second, V4l2SourceTable)
    assert second.path == "/dev/v4l/by-id/usb-eye"
    lens = room.cameras[0].intrinsics
    assert (lens.width, lens.height, lens.fx, lens.cx, lens.cy) == (640, 480, 152.789, 318.25, 241.5)
    assert room.cameras[0].world_from_camera.tolist() == [[float(i == j) for j in range(4)] for i in range(4)]
    text = (tmp_path / "room.toml").read_text()
    assert "Not calibrated" in text
    assert "# Maker Eye 4711\n" in text
    assert 'model = "models/room.glb"' in text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["models", "room.toml"]


def test_nothing_is_overwritten_unless_it_is_asked_for(tmp_path: Path, model: Path) -> None:
    path = tmp_path / "room.toml"
    path.write_text("# mine\n")
    with pytest.raises(ConfigError, match="exists already"):
        create_room(path, [planned()], name="lab", model=model)
    assert path.read_text() == "# mine\n"
    path.chmod(0o600)
    create_room(path, [planned()], name="lab", model=model, overwrite=True)
    assert load_room(path).name == "lab"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("ending", ["", "\n", "\n\n# last words\n"])
def test_added_cameras_leave_every_character_as_it_was(
    tmp_path: Path, model: Path, newline: str, ending: str
) -> None:
    path = tmp_path / "room.toml"
    before = new_room_text("lab", "models/room.glb", 10.0, [planned()]).rstrip("\n") + ending
    before = before.replace("name =", "# measured on a Tuesday\nname   =").replace("\n", newline)
    path.write_bytes(before.encode())
    room = add_cameras(
        path, [planned("cam1", kind="aravis", serial="1"), planned("cam2", kind="aravis", serial="2")]
    )
    assert [camera.camera_id for camera in room.cameras] == ["cam0", "cam1", "cam2"]
    after = path.read_bytes().decode()
    assert after.startswith(before)
    assert after.count("\n") == after.count(newline)
    assert [item.name for item in tmp_path.iterdir() if item.is_file()] == ["room.toml"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format = [", "not valid TOML"),
        ('cameras = [{ id = "cam0" }]\n', r"\[\[cameras\]\]"),
        ('[room]\nname = "x"\n', "unknown key"),
        ('format = 1\nname = "lab"\nmodel = "gone.glb"\n', "gone.glb"),
        ('format = 1\nname = "lab"\nmodel = "models/room.glb"\n"cameras" = 3\n', "TOML"),
    ],
)
def test_files_that_cannot_be_added_to_stay(tmp_path: Path, model: Path, text: str, message: str) -> None:
    path = tmp_path / "room.toml"
    path.write_text(text)
    with pytest.raises((ConfigError, AssetError), match=message) as raised:
        add_cameras(path, [planned()])
    assert "room.toml" in str(raised.value)
    assert path.read_text() == text
    assert [item.name for item in tmp_path.iterdir() if item.is_file()] == ["room.toml"]


def test_what_cannot_be_a_room_is_not_written(tmp_path: Path, model: Path) -> None:
    path = tmp_path / "room.toml"
    with pytest.raises(ConfigError, match=r"room\.toml:cameras\.id"):
        create_room(path, [planned(), planned()], name="lab", model=model)
    with pytest.raises(AssetError, match="no such model"):
        create_room(path, [planned()], name="lab", model=tmp_path / "gone.glb")
    with pytest.raises(ConfigError, match=r"\.toml"):
        create_room(tmp_path / "room.txt", [planned()], name="lab", model=model)
    with pytest.raises(AssetError, match="cannot be written"):
        create_room(tmp_path / "no" / "folder" / "room.toml", [planned()], name="lab", model=model)
    with pytest.raises(AssetError, match="cannot be read"):
        add_cameras(path, [planned()])
    assert [item.name for item in tmp_path.iterdir()] == ["models"]


@given(st.lists(st.text(max_size=20), max_size=3), st.text(max_size=20))
def test_whatever_a_camera_calls_itself_stays_a_comment(remarks: list[str], serial: str) -> None:
    camera = PlannedCamera(
        camera_id="cam0",
        lens=default_lens(64, 48),
        source={"kind": "aravis", "serial": serial},
        remarks=tuple(remarks),
    )
    tables = tomllib.loads(with_cameras("", [camera]))
    assert list(tables) == ["cameras"]
    assert tables["cameras"][0]["source"] == {"kind": "aravis", "serial": serial}
    assert tables["cameras"][0]["id"] == "cam0"


def test_free_names() -> None:
    assert free_camera_id([]) == "cam0"
    assert free_camera_id(["cam0", "door", "cam2"]) == "cam1"
    assert camera_ids(new_room_text("lab", "a.glb", 10, [planned("door"), planned("cam1")])) == [
        "door",
        "cam1",
    ]
