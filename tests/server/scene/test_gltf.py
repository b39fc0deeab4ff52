from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nearfield_server.errors import AssetError
from nearfield_server.scene.gltf import read_glb_chunks, read_primitives, write_glb

POSITIONS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype="<f4")
INDICES = np.array([0, 1, 2, 0, 2, 3], dtype="<u2")
ALBEDO = 0.012345678901234567


def document(**node: Any) -> tuple[dict[str, Any], bytes]:
    binary = POSITIONS.tobytes() + INDICES.tobytes()
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **node}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [
            {
                "name": "wall",
                "emissiveFactor": [9, 9, 9],
                "pbrMetallicRoughness": {"baseColorFactor": [ALBEDO, 0, 1, 1]},
            }
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12},
        ],
        "buffers": [{"byteLength": len(binary)}],
    }, binary


def write(folder: Path, document_and_binary: tuple[dict[str, Any], bytes]) -> Path:
    write_glb(folder / "a.glb", *document_and_binary)
    return folder / "a.glb"


def test_reads_mesh_and_exact_albedo(tmp_path: Path) -> None:
    (primitive,) = read_primitives(write(tmp_path, document()))
    np.testing.assert_array_equal(primitive.positions, POSITIONS)
    np.testing.assert_array_equal(primitive.faces, INDICES.reshape(-1, 3))
    assert primitive.material == "wall"
    assert primitive.albedo == (ALBEDO, 0.0, 1.0)
    assert primitive.normals is None
    assert primitive.uv is None


def test_node_transforms_nest(tmp_path: Path) -> None:
    parts = document(translation=[1, 2, 3])
    parts[0]["nodes"].append(
        {"children": [0], "rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "scale": [2, 2, 2]}
    )
    parts[0]["scenes"][0]["nodes"] = [1]
    (primitive,) = read_primitives(write(tmp_path, parts))
    moved = 2 * (POSITIONS + np.array([1, 2, 3]))
    expected = np.stack([-moved[:, 1], moved[:, 0], moved[:, 2]], axis=1)
    np.testing.assert_allclose(primitive.positions, expected, atol=1e-12)


def test_matrix_is_column_major(tmp_path: Path) -> None:
    matrix = np.eye(4)
    matrix[:3, 3] = [5, 6, 7]
    (primitive,) = read_primitives(write(tmp_path, document(matrix=matrix.T.reshape(-1).tolist())))
    np.testing.assert_allclose(primitive.positions, POSITIONS + np.array([5, 6, 7]))


def test_mirroring_keeps_the_front_in_front(tmp_path: Path) -> None:
    (plain,) = read_primitives(write(tmp_path, document()))
    (mirrored,) = read_primitives(write(tmp_path, document(scale=[-1, 1, 1])))

    def normals(item: Any) -> np.ndarray:
        corners = item.positions[item.faces]
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    np.testing.assert_allclose(normals(mirrored), normals(plain) * [-1, 1, 1])


def test_lines_and_points_are_left_out_but_something_must_remain(tmp_path: Path) -> None:
    parts = document()
    parts[0]["meshes"][0]["primitives"][0]["mode"] = 1
    with pytest.raises(AssetError, match="expected at least one triangle"):
        read_primitives(write(tmp_path, parts))


def change_uri(parts: dict[str, Any]) -> None:
    parts["buffers"][0]["uri"] = "http://example.com/mesh.bin"


WRONG = [
    (change_uri, "expected data inside the GLB file"),
    (lambda d: d["accessors"][0].update(count=5), "expected 60 bytes"),
    (lambda d: d["accessors"][0].update(count=-1), "sizes and offsets >= 0"),
    (lambda d: d["accessors"][0].update(count=10**12), "bytes"),
    (lambda d: d["accessors"][1].update(count=5), "a multiple of 3, found 5"),
    (lambda d: d["accessors"][0].update(type="VEC2"), "3 components"),
    (lambda d: d["accessors"][0].update(sparse={}), "plain accessor"),
    (lambda d: d["bufferViews"][0].update(byteStride=4), "sizes and offsets"),
    (lambda d: d["nodes"][0].update(children=[0]), "its own parent"),
    (lambda d: d["nodes"][0].update(scale=[0, 1, 1]), "invertible transform"),
    (lambda d: d["nodes"][0].update(mesh=7), "broken glTF structure"),
    (lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"]), "Export without compression"),
    (
        lambda d: d["materials"][0]["pbrMetallicRoughness"].update(baseColorFactor=[2, 0, 0, 1]),
        r"materials\[0\].baseColorFactor",
    ),
    (lambda d: d["meshes"][0]["primitives"][0].update(mode=5), "Triangulate"),
]


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_broken_documents_are_refused_with_the_place(tmp_path: Path, change: Any, message: str) -> None:
    parts = document()
    change(parts[0])
    with pytest.raises(AssetError, match=message):
        read_primitives(write(tmp_path, parts))


def test_index_beyond_the_vertices_is_refused(tmp_path: Path) -> None:
    parts, binary = document()
    binary = binary[:48] + np.array([0, 1, 4, 0, 2, 3], dtype="<u2").tobytes()
    with pytest.raises(AssetError, match=r"primitives\[0\].indices: expected indices below 4, found 4"):
        read_primitives(write(tmp_path, (parts, binary)))


def test_positions_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    parts, binary = document()
    binary = struct.pack("<f", float("nan")) + binary[4:]
    with pytest.raises(AssetError, match="POSITION: expected finite numbers"):
        read_primitives(write(tmp_path, (parts, binary)))


def test_other_files_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.glb"
    with pytest.raises(AssetError, match="no such file"):
        read_glb_chunks(file)
    file.write_bytes(b"glTF")
    with pytest.raises(AssetError, match="found 4 bytes"):
        read_glb_chunks(file)
    file.write_bytes(json.dumps(document()[0]).encode())
    with pytest.raises(AssetError, match="not a GLB file"):
        read_glb_chunks(file)


@given(position=st.integers(0, 10**6), value=st.integers(0, 255), cut=st.booleans())
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_bytes_never_crash(tmp_path: Path, position: int, value: int, cut: bool) -> None:
    data = bytearray(write(tmp_path, document()).read_bytes())
    position %= len(data)
    data[position] = value
    (tmp_path / "b.glb").write_bytes(data[:position] if cut else data)
    try:
        primitives = read_primitives(tmp_path / "b.glb")
    except AssetError:
        return
    assert all(np.isfinite(item.positions).all() for item in primitives)
