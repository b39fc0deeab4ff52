from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from nearfield_server.virtual_lab.glb import pack_room, write_object_glb, write_room_glb
from nearfield_server.virtual_lab.model import Scene


def read_document(path: Path) -> dict[str, object]:
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document: dict[str, object] = json.loads(data[20 : 20 + length])
    return document


@pytest.fixture
def room_path(tiny_scene: Scene, tmp_path: Path) -> Path:
    path = tmp_path / "room.glb"
    write_room_glb(tiny_scene, pack_room(tiny_scene), path)
    return path


def test_room_read_by_trimesh_has_the_same_surface(tiny_scene: Scene, room_path: Path) -> None:
    loaded = trimesh.load(room_path)
    assert sum(g.area for g in loaded.geometry.values()) == pytest.approx(
        sum(q.area for q in tiny_scene.quads), rel=1e-6
    )
    np.testing.assert_allclose(loaded.bounds, [[0, 0, 0], tiny_scene.size], atol=1e-6)
    for node in loaded.graph.nodes_geometry:
        mesh = loaded.geometry[loaded.graph[node][1]]
        np.testing.assert_allclose(mesh.face_normals, mesh.vertex_normals[mesh.faces[:, 0]], atol=1e-5)


def test_albedo_and_emission_are_exact(tiny_scene: Scene, room_path: Path) -> None:
    document = read_document(room_path)
    materials = {m["name"]: m for m in document["materials"]}  # type: ignore[attr-defined]
    for name, albedo in tiny_scene.materials.items():
        assert materials[name]["pbrMetallicRoughness"]["baseColorFactor"] == [*albedo, 1.0]
    for k, light in enumerate(tiny_scene.lights):
        material = materials[tiny_scene.emitter(k).material]
        strength = material["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
        np.testing.assert_allclose(
            np.array(material["emissiveFactor"]) * strength, light.radiance, rtol=1e-12
        )
        assert max(material["emissiveFactor"]) <= 1.0


def test_charts_do_not_overlap_and_keep_their_proportions(tiny_scene: Scene) -> None:
    atlas = pack_room(tiny_scene)
    assert max(atlas.width, atlas.height) <= tiny_scene.atlas_size
    assert atlas.uv.min() >= 0
    assert atlas.uv.max() <= 1
    size = np.array([atlas.width, atlas.height])
    owner = np.full((atlas.height, atlas.width), -1)
    centres = np.stack(np.meshgrid(np.arange(atlas.width), np.arange(atlas.height)), axis=-1) + 0.5
    for index, (quad, uv) in enumerate(zip(tiny_scene.quads, atlas.uv * size, strict=True)):
        edges = np.stack([uv[1] - uv[0], uv[3] - uv[0]], axis=1)
        length = np.linalg.norm([quad.e1, quad.e2], axis=1) * atlas.texels_per_metre
        # xatlas grows charts to whole texels
        np.testing.assert_allclose(np.linalg.norm(edges, axis=0), length, atol=1.0)
        coordinates = (centres - uv[0]) @ np.linalg.inv(edges).T
        inside = np.all((coordinates > 0) & (coordinates < 1), axis=-1)
        assert np.all(owner[inside] == -1), f"quad {index} overlaps another chart"
        owner[inside] = index


def test_object_glb_round_trip(tiny_scene: Scene, tmp_path: Path) -> None:
    item = tiny_scene.objects[0]
    path = tmp_path / "ball.glb"
    write_object_glb(item, path)
    mesh = next(iter(trimesh.load(path).geometry.values()))
    np.testing.assert_array_equal(np.asarray(mesh.vertices), item.positions)
    np.testing.assert_array_equal(mesh.faces, item.faces)
    np.testing.assert_allclose(mesh.vertex_normals, item.normals, atol=1e-6)
