"""The shipped bundles: complete, consistent with their own scene.json and physically plausible."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from nearfield_server.virtual_lab.pictures import read_exr

SIZE_LIMIT = {"tiny_room": 600e3, "lab": 25e6}


@pytest.fixture
def scene(bundle: Path) -> dict[str, Any]:
    description: dict[str, Any] = json.loads((bundle / "scene.json").read_text())
    return description


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as archive:
        return dict(archive)


def listed_pictures(scene: dict[str, Any]) -> list[str]:
    names = [name for camera in scene["cameras"] for name in camera["files"]]
    for view in scene["views"]:
        for key in ("background", "with_object"):
            names += view[key] + view[f"small_{key}"] + view[f"small_direct_{key}"]
    return names


def test_every_listed_file_exists_and_nothing_else(bundle: Path, scene: dict[str, Any]) -> None:
    expected = {
        *listed_pictures(scene),
        "scene.json",
        "room.glb",
        "points.npz",
        "cells.npz",
        "noise.json",
        "PROVENANCE.md",
    }
    expected |= {item["glb"] for item in scene["objects"]} | {view["mask"] for view in scene["views"]}
    expected |= {f"cam{c['id']}_preview.jpg" for c in scene["cameras"]} | {
        f"view{v['id']}_preview.jpg" for v in scene["views"]
    }
    found = {str(path.relative_to(bundle)) for path in bundle.rglob("*") if path.is_file()}
    assert found == expected


def test_size_limit(bundle: Path) -> None:
    assert sum(path.stat().st_size for path in bundle.rglob("*") if path.is_file()) < SIZE_LIMIT[bundle.name]


def test_pictures_have_the_size_of_their_sensor(bundle: Path, scene: dict[str, Any]) -> None:
    for camera in scene["cameras"]:
        picture = read_exr(bundle / camera["files"][0])
        assert picture.shape == (camera["height"], camera["width"], 3)
        assert np.isfinite(picture).all()
        column, row = np.meshgrid(np.arange(camera["width"]), np.arange(camera["height"]))
        theta = np.radians(camera["theta_max_deg"])
        limit = camera["fx"] * theta * (1 + sum(c * theta ** (2 * n + 2) for n, c in enumerate(camera["k"])))
        outside = np.hypot(column - camera["cx"], row - camera["cy"]) > limit + 12
        assert np.all(picture[outside] == 0), (
            "beyond the image circle (12 px for the 8x8 blocks of the codec)"
        )
    for view in scene["views"]:
        assert read_exr(bundle / view["background"][0]).shape == (view["height"], view["width"], 3)
        small = view["small"]
        assert read_exr(bundle / view["small_background"][0]).shape == (small["height"], small["width"], 3)
        mask = cv2.imread(str(bundle / view["mask"]), cv2.IMREAD_UNCHANGED)
        assert mask.shape == (view["height"], view["width"])
        assert 0.03 < np.mean(mask > 127) < 0.7, "the objects fill a good part of the picture"


def test_small_views_are_box_averages(bundle: Path, scene: dict[str, Any]) -> None:
    for view in scene["views"]:
        for full_name, small_name in zip(view["with_object"], view["small_with_object"], strict=True):
            full, small = read_exr(bundle / full_name), read_exr(bundle / small_name)
            averaged = full.reshape(small.shape[0], 2, small.shape[1], 2, 3).mean(axis=(1, 3))
            assert averaged.mean() == pytest.approx(small.mean(), rel=0.01)


def test_emitters_show_their_basis_radiance(bundle: Path, scene: dict[str, Any]) -> None:
    seen = set()
    for light in scene["lights"]:
        for camera in scene["cameras"]:
            picture = read_exr(bundle / camera["files"][light["index"]])
            bright = picture.min(axis=-1) > 0.9 * light["basis_radiance"]
            if bright.sum() > 30:
                np.testing.assert_allclose(np.median(picture[bright]), light["basis_radiance"], rtol=0.02)
                seen.add(light["index"])
    # A lamp under a shade and a strip under a shelf may show less than 30 pixels, all others are seen.
    assert len(seen) >= max(1, len(scene["lights"]) - 2)


def test_cells_predict_camera_pixels(bundle: Path, scene: dict[str, Any]) -> None:
    """The ceiling around a camera, away from the lamps: pictures and cells were sampled separately and hold the same radiance."""
    cells = load_arrays(bundle / "cells.npz")
    camera = scene["cameras"][-1]
    world_from_camera = np.array(camera["camera_to_world"])
    offset = cells["centre"] - world_from_camera[:3, 3]
    local = offset @ world_from_camera[:3, :3]
    theta = np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2])
    phi = np.arctan2(local[:, 1], local[:, 0])
    radius = camera["fx"] * theta * (1 + sum(c * theta ** (2 * n + 2) for n, c in enumerate(camera["k"])))
    column = np.round(camera["cx"] + radius * np.cos(phi)).astype(int)
    row = np.round(camera["cy"] + radius * np.sin(phi)).astype(int)
    chosen = cells["valid"] & (cells["centre"][:, 1] > scene["size"][1] - 1e-3) & (theta < np.radians(85))
    chosen &= offset[:, 1] > 0.3 * np.linalg.norm(offset, axis=1)
    for light in scene["lights"]:
        shape = light["geometry"]
        middle = np.array(shape["p0"]) + (np.array(shape["e1"]) + np.array(shape["e2"])) / 2
        reach = 0.2 + np.linalg.norm([shape["e1"], shape["e2"]], axis=1).max() / 2
        chosen &= np.linalg.norm((cells["centre"] - middle)[:, [0, 2]], axis=1) > reach
    assert chosen.sum() > 50
    for k in range(len(scene["lights"])):
        shown = read_exr(bundle / camera["files"][k])[row[chosen], column[chosen]]
        expected = cells["reflected_radiance"][chosen, k].astype(np.float64)
        assert shown.sum() == pytest.approx(expected.sum(), rel=0.03)


def test_cells_cover_the_room_mesh(bundle: Path) -> None:
    cells = load_arrays(bundle / "cells.npz")
    room = trimesh.load(bundle / "room.glb")
    assert cells["area"].sum() == pytest.approx(sum(g.area for g in room.geometry.values()), rel=1e-5)
    assert np.all(cells["reflected_radiance"] >= 0)


def test_objects_are_closed_and_stand_on_real_surfaces(bundle: Path, scene: dict[str, Any]) -> None:
    room = trimesh.load(bundle / "room.glb").to_mesh()
    for item in scene["objects"]:
        mesh = trimesh.load(bundle / item["glb"]).to_mesh()
        mesh.merge_vertices(merge_norm=True, merge_tex=True)
        assert mesh.is_watertight
        world_from_object = np.array(item["object_to_world"])
        positions = mesh.vertices @ world_from_object[:3, :3].T + world_from_object[:3, 3]
        lowest = positions[positions[:, 1].argmin()]
        above = [[lowest[0], lowest[1] + 0.01, lowest[2]]]
        hits, _, _ = room.ray.intersects_location(above, [[0.0, -1.0, 0.0]])
        assert hits[:, 1].max() == pytest.approx(lowest[1], abs=1e-5)


def test_points_lie_on_their_objects(bundle: Path, scene: dict[str, Any]) -> None:
    points = load_arrays(bundle / "points.npz")
    lights = len(scene["lights"])
    count = len(points["position"])
    assert points["with_direct"].shape == points["bg_direct"].shape == (count, lights)
    assert points["with_indirect"].shape == points["bg_indirect"].shape == (count, lights, 3)
    assert list(points["object_names"]) == [item["name"] for item in scene["objects"]]
    for index, item in enumerate(scene["objects"]):
        mesh = trimesh.load(bundle / item["glb"]).to_mesh()
        world_from_object = np.array(item["object_to_world"])
        vertices = mesh.vertices @ world_from_object[:3, :3].T + world_from_object[:3, 3]
        chosen = points["position"][points["object"] == index]
        distance = np.linalg.norm(chosen[:, None] - vertices, axis=-1).min(axis=1)
        assert distance.max() < 1e-6
    assert np.all(points["with_direct"] <= points["bg_direct"]), "same samples, more blockers"


def test_noise_is_small_and_complete(bundle: Path, scene: dict[str, Any]) -> None:
    noise = json.loads((bundle / "noise.json").read_text())
    for view in scene["views"]:
        entry = noise[f"view{view['id']}"]
        assert set(entry) == {f"light{k}" for k in range(len(scene["lights"]))} | {"nominal"}
        assert entry["nominal"]["with_obj_small"]["rel"] < 0.03
        assert (
            entry["nominal"]["shadow_diff_small"]["noise_rms"]
            < 0.05 * entry["nominal"]["shadow_diff_small"]["signal_rms"]
        )
    for camera in scene["cameras"]:
        assert set(noise[f"cam{camera['id']}"]) == {f"light{k}" for k in range(len(scene["lights"]))}


def test_sequences_fit_the_lights(scene: dict[str, Any]) -> None:
    for sequence in scene["sequences"]:
        weights = np.array(sequence["weights"])
        assert weights.shape[1] == len(scene["lights"])
        assert weights.min() >= 0
        assert weights.max() <= 1
