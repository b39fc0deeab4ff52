"""`nearfield prepare`: whole files in, whole files out, broken input answered in words."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
import trimesh

from nearfield_server.commands.prepare import parse_albedo
from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.radiometry.sh import clamped_cosine_coeffs
from nearfield_server.scene import prepared_model
from nearfield_server.scene.glb_writer import GlbWriter
from nearfield_server.scene.gltf import read_glb_chunks, write_glb
from nearfield_server.scene.gltf_accessors import Buffers
from nearfield_server.scene.model_source import load_source_model
from nearfield_server.scene.prepare import prepare_model
from nearfield_server.scene.prepared_cache import ensure_prepared
from nearfield_server.scene.prepared_model import load_prepared


def write_model(path, positions, faces, normals=None, *, albedo=(0.2, 0.4, 0.6), node=None):
    writer = GlbWriter()
    attributes = {"POSITION": writer.add_vectors(positions)}
    if normals is not None:
        attributes["NORMAL"] = writer.add_vectors(normals)
    primitive = {"attributes": attributes, "indices": writer.add_indices(faces), "material": 0}
    writer.document |= {
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [*albedo, 1.0]}}],
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0, **(node or {})}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    path.write_bytes(writer.to_bytes())
    return path


@pytest.fixture
def sphere_path(tmp_path):
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=0.25)
    vertices = np.asarray(sphere.vertices) + np.array([0, 0.25, 0])
    return write_model(tmp_path / "ball.glb", vertices, np.asarray(sphere.faces), np.asarray(sphere.vertices))


def test_what_is_written_is_what_is_read(sphere_path, tmp_path):
    out = tmp_path / "out" / "ball.glb"
    model = prepare_model(sphere_path, "preview", out)
    loaded = load_prepared(out)
    np.testing.assert_array_equal(loaded.positions, model.positions)
    np.testing.assert_array_equal(loaded.normals, model.normals)
    np.testing.assert_array_equal(loaded.faces, model.faces)
    np.testing.assert_array_equal(loaded.proxy.faces, model.proxy.faces)
    np.testing.assert_array_equal(loaded.occlusion_field.coeffs, model.occlusion_field.coeffs)
    np.testing.assert_array_equal(loaded.occlusion_field.box_min, model.occlusion_field.box_min)
    np.testing.assert_array_equal(loaded.transfer.shadowed, model.transfer.shadowed.astype(np.float32))
    assert (loaded.radius, loaded.preset, loaded.source_hash) == (model.radius, "preview", model.source_hash)
    assert sorted(p.name for p in out.parent.iterdir()) == ["ball.glb"]
    # A sphere is convex: its transfer is known.
    np.testing.assert_allclose(loaded.transfer.shadowed, clamped_cosine_coeffs(loaded.normals), atol=1e-6)
    np.testing.assert_allclose(loaded.centre, [0, 0.25, 0], atol=1e-6)
    np.testing.assert_allclose(loaded.radius, 0.25, atol=1e-6)
    np.testing.assert_allclose(loaded.albedo, [0.2, 0.4, 0.6])


def test_the_file_is_valid_gltf(sphere_path, tmp_path):
    out = tmp_path / "ball.prepared.glb"
    prepare_model(sphere_path, "preview", out)
    data = out.read_bytes()
    magic, version, total = struct.unpack_from("<III", data)
    assert (magic, version, total) == (0x46546C67, 2, len(data))
    document, binary = read_glb_chunks(out)
    buffers = Buffers(out, document, binary)
    assert [m["name"] for m in document["meshes"]] == ["model", "shadow_proxy"]
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    for name in ("_SHADOWED", "_BOUNCE1", "_BOUNCE2"):
        for part in range(3):
            accessor = document["accessors"][attributes[f"{name}_{part}"]]
            assert (accessor["type"], accessor["componentType"]) == ("VEC3", 5126)
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
    for mesh in document["meshes"]:
        index = mesh["primitives"][0]["attributes"]["POSITION"]
        positions = buffers.floats(index, 3, "POSITION")
        assert document["accessors"][index]["min"] == positions.min(axis=0).tolist()
        assert document["accessors"][index]["max"] == positions.max(axis=0).tolist()
    info = document["extras"]["nearfield"]
    nx, ny, nz = info["occlusionField"]["resolution"]
    view = document["bufferViews"][info["occlusionField"]["bufferView"]]
    assert view["byteLength"] == 2 * 12 * nx * ny * nz
    assert view["byteOffset"] + view["byteLength"] <= len(binary)
    # An independent reader accepts it and shows the model alone.
    scene = trimesh.load(out)
    assert len(scene.graph.nodes_geometry) == 1


def test_albedo_and_preset_are_checked(sphere_path):
    assert prepare_model(sphere_path, "preview", albedo=np.array([0.1, 0.2, 0.3])).albedo.tolist() == [
        0.1,
        0.2,
        0.3,
    ]
    with pytest.raises(AssetError, match="preview, medium, high"):
        prepare_model(sphere_path, "best")
    with pytest.raises(AssetError, match="albedo"):
        prepare_model(sphere_path, "preview", albedo=np.array([0.1, 0.2, 1.3]))
    for text in ("1,2", "a,b,c", "0.1,0.2,nan", "0.1,0.2,1.1"):
        with pytest.raises(ConfigError, match="--albedo"):
            parse_albedo(text)


def test_cache_is_keyed_by_content_and_survives_damage(sphere_path, tmp_path, monkeypatch):
    monkeypatch.delenv("NEARFIELD_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    first = ensure_prepared(sphere_path, "preview")
    assert first.is_relative_to(tmp_path / "cache")
    stamp = first.stat().st_mtime_ns
    assert ensure_prepared(sphere_path, "preview") == first
    assert first.stat().st_mtime_ns == stamp
    assert ensure_prepared(first, "preview") == first
    assert ensure_prepared(sphere_path, "preview", np.array([0.5, 0.5, 0.5])) != first
    first.write_bytes(first.read_bytes()[:1000])
    assert load_prepared(ensure_prepared(sphere_path, "preview")).preset == "preview"
    write_model(sphere_path, np.eye(3), np.array([[0, 1, 2]]))
    assert ensure_prepared(sphere_path, "preview") != first


def test_the_mean_albedo_of_white_is_white(tmp_path):
    rng = np.random.default_rng(5)
    positions = rng.random((3000, 3))
    path = write_model(tmp_path / "m.glb", positions, np.arange(3000).reshape(-1, 3), albedo=(1.0, 1.0, 1.0))
    assert load_source_model(path).albedo.tolist() == [1.0, 1.0, 1.0]


def test_node_transforms_and_mirrored_nodes_are_applied(tmp_path):
    box = trimesh.creation.box(extents=(0.2, 0.2, 0.2))
    vertices, faces = np.asarray(box.vertices), np.asarray(box.faces)
    path = write_model(
        tmp_path / "box.glb", vertices, faces, node={"scale": [-1, 2, 1], "translation": [0, 1, 0]}
    )
    source = load_source_model(path)
    corners = source.positions[source.faces]
    volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(0.2 * 0.4 * 0.2)
    np.testing.assert_allclose(source.positions.mean(axis=0), [0, 1, 0], atol=1e-7)
    assert np.einsum("ij,ij->i", source.normals, source.positions - [0, 1, 0]).min() > 0
    assert any("computed 8 missing normals" in note for note in source.notes)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda data: b"", "expected a GLB file"),
        (lambda data: b"solid nonsense" * 10, "not a GLB"),
        (lambda data: data[: len(data) // 2], "truncated"),
        (lambda data: data.replace(b'"byteLength":', b'"byteLengtX":'), "broken glTF"),
        (lambda data: data.replace(b'"VEC3"', b'"VEC2"'), "3 components"),
        (lambda data: data.replace(b'"nodes":[{"mesh":0}]', b'"nodes":[{"mesh":9}]'), "broken glTF"),
        (lambda data: data.replace(b'"mesh":0}', b'"mexh":0}'), "at least one triangle"),
        (lambda data: data.replace(b'{"asset"', b'["asset"'), "JSON"),
    ],
)
def test_broken_files_are_refused_in_words(tmp_path, damage, words):
    path = write_model(tmp_path / "m.glb", np.eye(3), np.array([[0, 1, 2]]))
    broken = tmp_path / "broken.glb"
    broken.write_bytes(damage(path.read_bytes()))
    with pytest.raises(AssetError, match=words):
        load_source_model(broken)
    assert load_source_model(path).faces.tolist() == [[0, 1, 2]]


def test_bad_geometry_is_refused_in_words(tmp_path):
    path = tmp_path / "m.glb"
    with pytest.raises(AssetError, match="indices below 3"):
        load_source_model(write_model(path, np.eye(3), np.array([[0, 1, 3]])))
    with pytest.raises(AssetError, match="zero area"):
        load_source_model(write_model(path, np.eye(3), np.array([[0, 1, 1]])))
    with pytest.raises(AssetError, match="metres"):
        load_source_model(write_model(path, np.eye(3) * 1000, np.array([[0, 1, 2]])))
    with pytest.raises(AssetError, match="no such file"):
        load_source_model(tmp_path / "missing.glb")
    with pytest.raises(AssetError, match="baseColorFactor"):
        load_source_model(write_model(path, np.eye(3), np.array([[0, 1, 2]]), albedo=(2.0, 0, 0)))


def test_unprepared_and_foreign_versions_are_told_apart(sphere_path, tmp_path, monkeypatch):
    with pytest.raises(AssetError, match="not a prepared model"):
        load_prepared(sphere_path)
    out = tmp_path / "p.glb"
    prepare_model(sphere_path, "preview", out)
    monkeypatch.setattr(prepared_model, "FORMAT_VERSION", 99)
    with pytest.raises(AssetError, match="format 2"):
        load_prepared(out)
    monkeypatch.undo()
    document, binary = read_glb_chunks(out)
    write_glb(out, json.loads(json.dumps(document).replace("_BOUNCE2_2", "_BOUNCE2_9")), binary)
    with pytest.raises(AssetError, match="incomplete"):
        load_prepared(out)
