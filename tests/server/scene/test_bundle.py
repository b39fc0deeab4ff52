from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.scene.bundle import light_factors, load_bundle, mix_basis
from nearfield_server.scene.room_config import LabSourceConfig, load_room

POSE = np.eye(4).tolist()
PINHOLE = {"width": 96, "height": 54, "fx": 80.0, "fy": 80.0, "cx": 47.5, "cy": 26.5}
SCENE: dict[str, Any] = {
    "room": "A",
    "materials": {"floor": {"diffuse_albedo": [0.5, 0.4, 0.3]}},
    "room_glb": "room.glb",
    "lights": [
        {"index": 0, "name": "lamp", "radiance": [15.0, 14.0, 13.0], "basis_radiance": 100.0},
        {"index": 1, "name": "window", "radiance": [3.0, 3.0, 4.0], "basis_radiance": 50.0},
    ],
    "objects": [{"name": "bunny", "glb": "bunny.glb", "albedo": [0.7, 0.7, 0.7], "object_to_world": POSE}],
    "cameras": [
        {
            "id": 0,
            "model": "kannala_brandt",
            "width": 64,
            "height": 64,
            "fx": 20.0,
            "fy": 20.0,
            "cx": 31.5,
            "cy": 31.5,
            "k": [0.01, 0.0, 0.0, 0.0],
            "theta_max_deg": 90.0,
            "camera_to_world": POSE,
            "files": ["c0.exr", "c1.exr"],
        }
    ],
    "views": [
        {
            "id": 0,
            "model": "pinhole",
            **PINHOLE,
            "camera_to_world": POSE,
            "small": PINHOLE,
            "objects": ["bunny"],
            "background": ["v0.exr", "v1.exr"],
            "with_object": ["w0.exr", "w1.exr"],
            "mask": "mask.png",
        }
    ],
    "sequences": [{"name": "on", "fps": 30, "weights": [[0.0, 1.0], [0.5, 1.0]]}],
}
FILES = (
    "room.glb",
    "bunny.glb",
    "c0.exr",
    "c1.exr",
    "v0.exr",
    "v1.exr",
    "w0.exr",
    "w1.exr",
    "mask.png",
    "cells.npz",
)


def write(folder: Path, change: Callable[[dict[str, Any]], None] | None = None) -> Path:
    scene = copy.deepcopy(SCENE)
    if change is not None:
        change(scene)
    for name in FILES:
        (folder / name).touch()
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder


def test_reads_every_part(tmp_path: Path) -> None:
    bundle = load_bundle(write(tmp_path))
    assert (bundle.name, len(bundle.lights), len(bundle.views)) == ("A", 2, 1)
    assert bundle.materials == {"floor": (0.5, 0.4, 0.3)}
    assert bundle.cameras[0].files == (tmp_path / "c0.exr", tmp_path / "c1.exr")
    assert bundle.cameras[0].model.intrinsics.theta_max == pytest.approx(np.pi / 2)
    assert bundle.views[0].mask == tmp_path / "mask.png"
    assert bundle.views[0].small_background == ()
    assert bundle.cells == tmp_path / "cells.npz"
    assert bundle.points is None
    assert load_bundle(tmp_path / "scene.json").name == "A"


def test_lighting_by_name_and_frame(tmp_path: Path) -> None:
    bundle = load_bundle(write(tmp_path))
    np.testing.assert_array_equal(bundle.weights("nominal"), [1.0, 1.0])
    np.testing.assert_array_equal(bundle.weights("on:1"), [0.5, 1.0])
    for wrong in ("on", "on:2", "on:-1", "off:0", "on:x"):
        with pytest.raises(ConfigError, match="lighting"):
            bundle.weights(wrong)


def test_mixing_is_linear_and_coloured_per_light(tmp_path: Path) -> None:
    bundle = load_bundle(write(tmp_path))
    files = [np.full((2, 3, 3), 100.0), np.full((2, 3, 3), 50.0)]
    np.testing.assert_allclose(
        mix_basis(files, bundle.light_factors(np.array([1.0, 0.0])))[0, 0], [15, 14, 13]
    )
    np.testing.assert_allclose(
        mix_basis(files, bundle.light_factors(np.array([0.5, 2.0])))[1, 2], [13.5, 13, 14.5]
    )
    with pytest.raises(ConfigError, match="light weights: expected 2"):
        light_factors(bundle.lights, np.ones(3))
    with pytest.raises(ConfigError, match=">= 0"):
        light_factors(bundle.lights, np.array([1.0, -1.0]))


def test_a_bundle_is_a_room(tmp_path: Path) -> None:
    room = load_room(write(tmp_path))
    assert room.sources == (LabSourceConfig(files=(tmp_path / "c0.exr", tmp_path / "c1.exr")),)
    assert [light.weight for light in room.lights] == [1.0, 1.0]
    assert room.objects[0].name == "bunny"
    assert room.views[0].background_files == ("v0.exr", "v1.exr")


WRONG: list[tuple[Callable[[dict[str, Any]], Any], str]] = [
    (lambda s: s.pop("room"), "scene.json:room: expected a text, found nothing"),
    (lambda s: s.update(room_glb="none.glb"), "scene.json:room_glb: expected an existing file"),
    (lambda s: s.update(room_glb="../room.glb"), "scene.json:room_glb: expected a file inside the folder"),
    (lambda s: s.update(lights=[]), "scene.json:lights: expected at least one light"),
    (
        lambda s: s["lights"][1].update(basis_radiance=0),
        r"lights\[1\].basis_radiance: expected a finite number > 0",
    ),
    (lambda s: s["lights"][0].update(radiance=[1, 2]), r"lights\[0\].radiance: expected three numbers"),
    (lambda s: s["lights"][0].update(radiance=[1, 2, -3]), r"lights\[0\].radiance"),
    (lambda s: s["cameras"][0].update(files=["c0.exr"]), r"cameras\[0\].files: expected 2 files"),
    (lambda s: s["cameras"][0].update(model="pinhole"), r"cameras\[0\].model: expected a fish-eye"),
    (lambda s: s["cameras"][0].update(theta_max_deg=200), r"cameras\[0\].k: expected a usable lens"),
    (lambda s: s["cameras"][0].update(k=[-0.3, 0, 0, 0]), r"cameras\[0\].k: .*stops growing"),
    (lambda s: s["cameras"][0].update(width=64.5), r"cameras\[0\].width: expected an integer"),
    (
        lambda s: s["cameras"][0].update(camera_to_world=[[1]]),
        r"cameras\[0\].camera_to_world: expected a 4 x 4",
    ),
    (lambda s: s["cameras"][0].update(fx="x"), r"cameras\[0\].fx: expected a finite number"),
    (lambda s: s["views"][0].update(objects=["cat"]), r"views\[0\].objects: expected names among"),
    (lambda s: s["views"][0].update(background="v0.exr"), r"views\[0\].background: expected a list of texts"),
    (
        lambda s: s["objects"][0].update(albedo=[0.5, 0.5, 1.5]),
        r"objects\[0\].albedo: expected three numbers in",
    ),
    (
        lambda s: s["sequences"][0].update(weights=[[1.0]]),
        r"sequences\[0\].weights: expected rows of 2 numbers",
    ),
    (
        lambda s: s["sequences"][0].update(weights=[[1.0, float("nan")]]),
        r"sequences\[0\].weights: .*not finite",
    ),
    (lambda s: s["materials"]["floor"].update(diffuse_albedo=None), "materials.floor.diffuse_albedo"),
]


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_wrong_field_is_named(tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str) -> None:
    with pytest.raises(AssetError, match=message):
        load_bundle(write(tmp_path, change))


def test_missing_or_broken_scene_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match=r"scene\.json: no such file"):
        load_bundle(tmp_path)
    (tmp_path / "scene.json").write_text("{")
    with pytest.raises(AssetError, match="not valid JSON"):
        load_bundle(tmp_path)
    (tmp_path / "scene.json").write_text("[]")
    with pytest.raises(AssetError, match="expected a JSON object"):
        load_bundle(tmp_path)
