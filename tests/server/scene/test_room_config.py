from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.scene.room_config import ExrSequenceSourceConfig, LabSourceConfig, load_room

IDENTITY = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"
ROOM = f"""
format = 1
name = "lab"
model = "room.glb"
[light]
num_vals = 32
[[lights]]
name = "lamp"
radiance = [15, 14.0, 13.0]
basis_radiance = 100
[[cameras]]
id = "cam0"
width = 64
height = 64
fx = 20.0
fy = 20.0
cx = 31.5
cy = 31.5
theta_max = 1.5
world_from_camera = {IDENTITY}
source = {{ kind = "lab", files = ["a.exr"] }}
[[cameras]]
id = "cam1"
width = 64
height = 64
fx = 20.0
fy = 20.0
cx = 31.5
cy = 31.5
k = [0.01, 0, 0, 0]
change_tolerance = 0.01
theta_max = 1.5
world_from_camera = {IDENTITY}
source = {{ kind = "exr_sequence", folder = "frames" }}
[[objects]]
name = "bunny"
model = "bunny.glb"
albedo = [0.7, 0.7, 0.7]
world_from_object = {IDENTITY}
[[views]]
id = "view0"
width = 96
height = 54
fx = 80.0
fy = 80.0
cx = 47.5
cy = 26.5
world_from_camera = {IDENTITY}
background = ["a.exr"]
"""


def write(folder: Path, text: str = ROOM) -> Path:
    folder.mkdir(exist_ok=True)
    for name in ("room.glb", "a.exr", "bunny.glb"):
        (folder / name).write_bytes(b"")
    (folder / "frames").mkdir()
    (folder / "room.toml").write_text(text)
    return folder / "room.toml"


def test_reads_every_table_and_resolves_paths(tmp_path: Path) -> None:
    room = load_room(write(tmp_path))
    assert load_room(tmp_path).name == room.name == "lab"
    assert room.folder == tmp_path
    assert room.model_path == tmp_path / "room.glb"
    assert room.light.num_vals == 32
    assert room.atlas_size == 1024
    assert room.lights[0].radiance == (15.0, 14.0, 13.0)
    assert room.lights[0].weight == 1.0
    assert room.sources == (
        LabSourceConfig(files=(tmp_path / "a.exr",)),
        ExrSequenceSourceConfig(folder=tmp_path / "frames"),
    )
    assert room.change_tolerances == (0.0, 0.01)
    assert room.cameras[1].intrinsics.k == (0.01, 0.0, 0.0, 0.0)
    np.testing.assert_array_equal(room.objects[0].world_from_object, np.eye(4))
    assert room.views[0].background_files == ("a.exr",)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("format = 1", "format = 2", "room.toml:format: "),
        ('name = "lab"', 'nmae = "lab"', "room.toml:nmae: unknown key. Did you mean 'name'?"),
        ("num_vals = 32", "num_vals = 65", r"room.toml:light.num_vals: .*64, found 65"),
        ("num_vals = 32", "num_val = 32", "light.num_val: unknown key. Did you mean 'num_vals'?"),
        ("fx = 20.0\n", "fx = -1.0\n", r"cameras\[0\].fx: .*greater than 0, found -1.0"),
        ("theta_max = 1.5\n", "theta_max = 90\n", r"cameras\[0\].theta_max: "),
        ("k = [0.01, 0, 0, 0]", "k = [-0.2, 0, 0, 0]", r"cameras\[1\]: .*stops growing"),
        ("k = [0.01, 0, 0, 0]", "k = [0.01, 0, 0]", r"cameras\[1\].k\[3\]: expected a value"),
        ('kind = "lab"', 'kind = "webcam"', r"cameras\[0\].source: "),
        ('folder = "frames"', 'folder = "frames", fps = 3', r"cameras\[1\].source.fps: unknown key"),
        (
            "[[1,0,0,0],[0,1,0,0]",
            "[[2,0,0,0],[0,1,0,0]",
            r"cameras\[0\].world_from_camera: .*not perpendicular",
        ),
        ("[[1,0,0,0],[0,1,0,0]", "[[-1,0,0,0],[0,1,0,0]", "mirrored"),
        ("change_tolerance = 0.01", "change_tolerance = 0.5", r"cameras\[1\].change_tolerance: .*0.1"),
        ("albedo = [0.7,", "albedo = [1.7,", r"objects\[0\].albedo\[0\]: "),
        ("basis_radiance = 100", "basis_radiance = nan", r"lights\[0\].basis_radiance: "),
        ('id = "cam1"', 'id = "cam0"', r"cameras.id: expected different values, found \['cam0'\]"),
        ('files = ["a.exr"]', 'files = ["a.exr", "a.exr"]', r"source.files: expected 1 files"),
        ("format = 1", "format = = 1", "not valid TOML"),
    ],
)
def test_wrong_key_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in ROOM
    with pytest.raises(ConfigError, match=message):
        load_room(write(tmp_path, ROOM.replace(old, new, 1)))


def test_all_wrong_keys_are_listed_at_once(tmp_path: Path) -> None:
    text = ROOM.replace("num_vals = 32", "num_vals = 1").replace("basis_radiance = 100", "")
    with pytest.raises(ConfigError) as caught:
        load_room(write(tmp_path, text))
    assert "light.num_vals" in str(caught.value)
    assert "lights[0].basis_radiance" in str(caught.value)


@pytest.mark.parametrize("name", ["bunny.glb", "a.exr", "room.glb"])
def test_missing_file_is_named_with_its_key(tmp_path: Path, name: str) -> None:
    file = write(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(AssetError, match=f"expected an existing file, found '{name}'"):
        load_room(file)


def test_a_real_room_has_devices_no_lamps_to_switch_and_one_background(tmp_path: Path) -> None:
    before, _, after = ROOM.partition("[[lights]]")
    text = before + after[after.index("[[cameras]]") :]
    text = text.replace('kind = "lab", files = ["a.exr"]', 'kind = "aravis", address = "192.168.10.21"')
    text = text.replace(
        'kind = "exr_sequence", folder = "frames"', 'kind = "v4l2", path = "/dev/v4l/by-id/usb-0"'
    )
    room = load_room(write(tmp_path, text))
    assert room.lights == ()
    assert [source.kind for source in room.sources] == ["aravis", "v4l2"]
    assert room.views[0].background_files == ("a.exr",)
    with pytest.raises(ConfigError, match="background: expected 1 files"):
        load_room(write(tmp_path / "two", text.replace('["a.exr"]', '["a.exr", "a.exr"]')))


def test_folder_without_room_says_what_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"room\.toml or scene\.json"):
        load_room(tmp_path)
    with pytest.raises(ConfigError, match="no such room"):
        load_room(tmp_path / "nowhere.toml")
