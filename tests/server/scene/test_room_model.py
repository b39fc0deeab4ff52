from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from nearfield_server.errors import AssetError
from nearfield_server.geometry.texels import face_areas
from nearfield_server.records import RoomMesh
from nearfield_server.reference.box_room import make_box_room
from nearfield_server.scene.gltf import read_glb_chunks, write_glb
from nearfield_server.scene.room_model import export_room_glb, load_room_mesh
from nearfield_server.scene.uv_raster import cover_texels


def box() -> RoomMesh:
    """The box room with float32 values, as any file holds them, and two materials."""
    mesh = make_box_room(atlas_size=128).mesh()
    return replace(
        mesh,
        uv=mesh.uv.astype(np.float32).astype(np.float64),
        face_material=np.repeat([0, 1], 6).astype(np.int32),
        materials=("wall", "floor"),
        material_albedo=np.array([[0.1, 0.2, 0.3], [1 / 3, 0.5, 0.012345678901]]),
    )


def edit(path: Path, change: Any) -> None:
    document, binary = read_glb_chunks(path)
    change(document)
    write_glb(path, document, binary)


def test_exported_room_comes_back_equal(tmp_path: Path) -> None:
    export_room_glb(box(), tmp_path / "room.glb")
    mesh = load_room_mesh(tmp_path / "room.glb", 128)
    assert mesh.uv_source == "file"
    np.testing.assert_array_equal(mesh.positions[mesh.faces], box().positions[box().faces])
    np.testing.assert_array_equal(mesh.uv[mesh.faces], box().uv[box().faces])
    np.testing.assert_array_equal(mesh.material_albedo, box().material_albedo)
    assert mesh.materials == ("wall", "floor")
    export_room_glb(mesh, tmp_path / "again.glb")
    assert load_room_mesh(tmp_path / "again.glb", 128).content_hash == mesh.content_hash


def test_emission_is_never_read(tmp_path: Path) -> None:
    export_room_glb(box(), tmp_path / "room.glb")
    before = load_room_mesh(tmp_path / "room.glb", 128).content_hash
    edit(tmp_path / "room.glb", lambda d: d["materials"][0].update(emissiveFactor=[1, 1, 1]))
    assert load_room_mesh(tmp_path / "room.glb", 128).content_hash == before


@pytest.mark.parametrize("case", ["no uv", "overlapping charts", "uv outside"])
def test_unusable_uv_are_replaced_by_an_atlas(tmp_path: Path, case: str) -> None:
    mesh = box()
    if case == "overlapping charts":
        mesh = replace(mesh, uv=np.tile(mesh.uv[:4], (6, 1)))
    if case == "uv outside":
        mesh = replace(mesh, uv=mesh.uv * 3)
    export_room_glb(mesh, tmp_path / "room.glb")
    if case == "no uv":
        edit(
            tmp_path / "room.glb",
            lambda d: [p["attributes"].pop("TEXCOORD_0") for p in d["meshes"][0]["primitives"]],
        )
    made = load_room_mesh(tmp_path / "room.glb", 256)
    assert made.uv_source == "xatlas"
    assert made.uv.min() >= 0
    assert made.uv.max() <= 1
    coverage = cover_texels(made.uv, made.faces, 256, 256)
    assert coverage.num_overlaps == 0
    assert len(np.unique(coverage.face)) == len(made.faces) + 1
    # Unwrapping changes no geometry.
    np.testing.assert_allclose(made.positions[made.faces], box().positions[box().faces])
    assert (coverage.face >= 0).mean() > 0.4


def test_flat_triangles_are_dropped_and_counted(tmp_path: Path) -> None:
    mesh = box()
    flat = np.array([[0, 0, 1], [0, 1, 1]], dtype=np.int32)
    bad = replace(
        mesh,
        faces=np.concatenate([mesh.faces, flat]),
        face_material=np.append(mesh.face_material, [0, 0]).astype(np.int32),
    )
    export_room_glb(bad, tmp_path / "room.glb")
    with capture_logs() as logs:
        made = load_room_mesh(tmp_path / "room.glb", 128)
    assert len(made.faces) == len(mesh.faces)
    assert logs[0]["left_out"] == 2
    assert (face_areas(made) > 0).all()


def test_missing_normals_are_computed(tmp_path: Path) -> None:
    export_room_glb(box(), tmp_path / "room.glb")
    edit(
        tmp_path / "room.glb", lambda d: [p["attributes"].pop("NORMAL") for p in d["meshes"][0]["primitives"]]
    )
    made = load_room_mesh(tmp_path / "room.glb", 128)
    np.testing.assert_allclose(made.normals[made.faces], box().normals[box().faces], atol=1e-12)


def test_room_without_usable_triangle_or_in_millimetres_is_refused(tmp_path: Path) -> None:
    mesh = box()
    export_room_glb(replace(mesh, positions=np.zeros_like(mesh.positions)), tmp_path / "a.glb")
    with pytest.raises(AssetError, match="triangles of positive area"):
        load_room_mesh(tmp_path / "a.glb")
    export_room_glb(replace(mesh, positions=mesh.positions * 1e5), tmp_path / "b.glb")
    with pytest.raises(AssetError, match="Is the model in metres"):
        load_room_mesh(tmp_path / "b.glb")
