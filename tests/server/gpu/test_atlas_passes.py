"""The GPU passes over the room against their CPU twins, on whatever renderer there is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from nearfield_server.geometry.probes import ProbeRays
from nearfield_server.geometry.texels import face_areas, rasterise_texels
from nearfield_server.gpu.atlas_raster import cover_texels_gl
from nearfield_server.gpu.context import GlContext, open_context
from nearfield_server.gpu.texel_id_cubes import TexelIdCubes
from nearfield_server.records import RoomMesh
from nearfield_server.reference import texels as reference
from nearfield_server.reference.box_room import make_box_room

pytestmark = pytest.mark.gl


@pytest.fixture(scope="module")
def context() -> Iterator[GlContext]:
    with open_context() as opened:
        yield opened


def scattered_mesh() -> RoomMesh:
    """A wrinkled sheet of 200 triangles whose UVs cut texels at random."""
    rng = np.random.default_rng(11)
    uv = np.concatenate(
        [[[0.05, 0.05], [0.95, 0.1], [0.9, 0.95], [0.1, 0.9]], rng.uniform(0.15, 0.85, (100, 2))]
    )
    faces = Delaunay(uv).simplices.astype(np.int32)
    positions = np.column_stack([uv[:, 0] * 3, 0.1 * np.sin(9 * uv[:, 0]), uv[:, 1] * 3])
    return RoomMesh(
        positions=positions,
        normals=np.tile([0.0, 1.0, 0.0], (len(uv), 1)),
        uv=uv,
        faces=faces,
        face_material=np.zeros(len(faces), dtype=np.int32),
        materials=("m",),
        material_albedo=np.full((1, 3), 0.5),
        uv_source="file",
        content_hash="",
    )


def test_atlas_coverage_agrees_with_the_reference_away_from_edges(context: GlContext) -> None:
    mesh = scattered_mesh()
    owner = cover_texels_gl(context, mesh.uv, mesh.faces, 120, 150)
    expected = reference.rasterise_texels(mesh, 120, 150)
    differs = owner != expected.face
    # OpenGL snaps vertices to 1/256 texel, which moves an edge by 1/512 along each axis at most.
    assert expected.edge_distance[differs].max(initial=0.0) < 1 / 256
    assert differs.mean() < 0.02
    assert (owner >= 0).mean() > 0.5


def test_flipped_triangles_cover_the_same_texels(context: GlContext) -> None:
    mesh = scattered_mesh()
    np.testing.assert_array_equal(
        cover_texels_gl(context, mesh.uv, np.ascontiguousarray(mesh.faces[:, ::-1]), 64, 64),
        cover_texels_gl(context, mesh.uv, mesh.faces, 64, 64),
    )


def test_both_rasterisers_give_one_geometry() -> None:
    mesh = scattered_mesh()
    cpu = rasterise_texels(mesh, 128, rasteriser="cpu")
    gl = rasterise_texels(mesh, 128, rasteriser="gl")
    common = np.intersect1d(cpu.texel_index, gl.texel_index, assume_unique=True)
    assert len(common) > 0.99 * max(len(cpu.texel_index), len(gl.texel_index))
    first, second = cpu.lookup.reshape(-1)[common], gl.lookup.reshape(-1)[common]
    same = cpu.face[first] == gl.face[second]
    assert same.mean() > 0.98
    np.testing.assert_array_equal(cpu.position[first[same]], gl.position[second[same]])
    np.testing.assert_array_equal(cpu.normal[first[same]], gl.normal[second[same]])
    for texels in (cpu, gl):
        assert texels.area.sum(dtype=np.float64) == pytest.approx(face_areas(mesh).sum(), rel=1e-6)


@pytest.mark.parametrize("centre", [(2.1, 1.2, 1.7), (0.4, 2.7, 3.5)])
def test_texel_id_cube_sees_what_probe_rays_see(
    context: GlContext, centre: tuple[float, float, float]
) -> None:
    mesh = make_box_room(atlas_size=128).mesh()
    # A table in the room, so that depth matters.
    table = np.array([[1.5, 0.7, 1.0], [1.5, 0.7, 2.0], [3.0, 0.7, 2.0], [3.0, 0.7, 1.0]])
    start = len(mesh.positions)
    mesh = replace(
        mesh,
        positions=np.concatenate([mesh.positions, table]),
        normals=np.concatenate([mesh.normals, np.tile([[0.0, 1.0, 0.0]], (4, 1))]),
        uv=np.concatenate([mesh.uv / 2, np.array([[140, 10], [140, 30], [170, 30], [170, 10]]) / 256]),
        faces=np.concatenate(
            [mesh.faces, [[start, start + 1, start + 2], [start, start + 2, start + 3]]]
        ).astype(np.int32),
        face_material=np.append(mesh.face_material, [0, 0]).astype(np.int32),
    )
    texels = rasterise_texels(mesh, 256, rasteriser="cpu")
    cubes = TexelIdCubes(context, mesh, texels, resolution=32)
    drawn = cubes.draw(np.array(centre))
    cubes.release()
    traced = ProbeRays(mesh, texels).trace(np.array(centre), 32)
    assert ((drawn < 0) == (traced < 0)).mean() > 0.99
    seen = (drawn >= 0) & (traced >= 0)
    # Silhouettes and triangle edges may fall to either side; elsewhere at most the neighbouring texel.
    assert (texels.face[drawn[seen]] == texels.face[traced[seen]]).mean() > 0.99
    assert (drawn[seen] == traced[seen]).mean() > 0.97


def test_cube_is_drawn_again_from_each_centre(context: GlContext) -> None:
    mesh = make_box_room(atlas_size=96).mesh()
    texels = rasterise_texels(mesh, 96, rasteriser="cpu")
    cubes = TexelIdCubes(context, mesh, texels, resolution=8)
    first = cubes.draw(np.array([1.0, 1.0, 1.0]))
    cubes.draw(np.array([5.0, 2.0, 3.0]))
    np.testing.assert_array_equal(cubes.draw(np.array([1.0, 1.0, 1.0])), first)
    cubes.release()
