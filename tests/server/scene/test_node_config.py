"""Node files, and what a room file must say about cameras of other machines."""

from __future__ import annotations

from pathlib import Path

import pytest

from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.scene.node_config import load_node
from nearfield_server.scene.room_config import LabSourceConfig, load_room

NODE = """
format = 1
node = "window"
room = "living room"
connect = "192.168.10.5:7448"
certificates = "certificates"
frame_rate = 10.0
[[lights]]
name = "lamp"
radiance = [1.0, 1.0, 1.0]
basis_radiance = 100.0
[[cameras]]
id = "cam3"
width = 64
height = 32
source = { kind = "lab", files = ["lamp.exr"] }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "certificates").mkdir()
    (tmp_path / "lamp.exr").touch()
    return tmp_path


def _load(folder: Path, text: str) -> object:
    (folder / "node.toml").write_text(text, encoding="utf-8")
    return load_node(folder / "node.toml")


def test_defaults_and_paths(folder: Path) -> None:
    _load(folder, NODE)
    node = load_node(folder / "node.toml")
    (camera,) = node.cameras
    assert (node.node, node.room, node.address) == ("window", "living room", "192.168.10.5:7448")
    assert node.certificates == folder / "certificates"
    assert (camera.reduce, camera.compression, camera.tiles, camera.max_rate) == (1, "zstd", True, 10.0)
    assert camera.source == LabSourceConfig(files=(folder / "lamp.exr",))
    assert node.lights[0].basis_radiance == 100.0


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("height = 32", "height = 32\nreduce = 4\nmax_rate = 99.0", ""),
        ("height = 32", "height = 31\nreduce = 2", "size that reduce = 2 divides, found 64x31"),
        ("height = 32", "height = 32\nreduce = 3", r"cameras\[0\].reduce"),
        ("height = 32", "height = 32\ncompress = 'zstd'", "unknown key. Did you mean 'compression'"),
        ("node =", "nod =", "nod: unknown key. Did you mean 'node'"),
        ("10.5:7448", "10.5", "connect: "),
        ("10.5:7448", "10.5:77777", "connect: expected a port of at most 65535"),
        ('"window"', '"wi*dow"', "node: "),
        ('"lab", files = ["lamp.exr"]', '"remote", node = "a", camera = "b"', r"cameras\[0\].source"),
        ('files = ["lamp.exr"]', 'files = ["lamp.exr", "lamp.exr"]', "expected 1 files"),
    ],
)
def test_wrong_keys_are_named(folder: Path, old: str, new: str, words: str) -> None:
    assert NODE.count(old) == 1
    if not words:
        _load(folder, NODE.replace(old, new))
        return
    with pytest.raises(ConfigError, match=words):
        _load(folder, NODE.replace(old, new))


def test_max_rate_is_at_most_the_frame_rate(folder: Path) -> None:
    _load(folder, NODE.replace("height = 32", "height = 32\nmax_rate = 2.5"))
    assert load_node(folder / "node.toml").cameras[0].max_rate == 2.5
    _load(folder, NODE.replace("height = 32", "height = 32\nmax_rate = 100.0"))
    assert load_node(folder / "node.toml").cameras[0].max_rate == 10.0


def test_missing_certificates_say_how_to_make_them(folder: Path) -> None:
    (folder / "certificates").rmdir()
    with pytest.raises(AssetError, match="nearfield certificates node"):
        _load(folder, NODE)


ROOM = """
format = 1
name = "r"
model = "room.glb"
{remote}
[[cameras]]
id = "a"
width = 64
height = 64
fx = 20.0
fy = 20.0
cx = 31.5
cy = 31.5
theta_max = 1.57
world_from_camera = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
source = {{ kind = "remote", node = "window", camera = "cam3" }}
"""
REMOTE = 'remote = { listen = "192.168.10.5:7448", certificates = "certificates" }'


def test_rooms_with_remote_cameras_need_a_door(folder: Path) -> None:
    (folder / "room.glb").touch()
    file = folder / "room.toml"
    file.write_text(ROOM.format(remote=REMOTE), encoding="utf-8")
    room = load_room(file)
    assert room.remote is not None
    assert (room.remote.address, room.remote.certificates) == ("192.168.10.5:7448", folder / "certificates")
    assert room.remote_nodes == ("window",)
    file.write_text(ROOM.format(remote=""), encoding="utf-8")
    with pytest.raises(ConfigError, match="expected a table with listen and certificates"):
        load_room(file)
    (folder / "certificates").rmdir()
    file.write_text(ROOM.format(remote=REMOTE), encoding="utf-8")
    with pytest.raises(AssetError, match="nearfield certificates room"):
        load_room(file)


def test_a_camera_of_a_node_is_taken_once(folder: Path) -> None:
    (folder / "room.glb").touch()
    text = ROOM.format(remote=REMOTE)
    camera = text[text.index("[[cameras]]") :]
    (folder / "room.toml").write_text(text + camera.replace('"a"', '"b"'), encoding="utf-8")
    with pytest.raises(ConfigError, match="window, cam3"):
        load_room(folder / "room.toml")
