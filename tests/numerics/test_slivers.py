"""Triangles of all shapes, down to slivers a nanometre wide: every texel is finite, and no area is lost or made."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.geometry.texels import rasterise_texels
from nearfield_server.records import RoomMesh

GRID = 3
ATLAS = 48


@st.composite
def meshes(draw: st.DrawFn) -> RoomMesh:
    """Nine triangles in cells of their own of the atlas; slivers in space, in the atlas, or in both."""
    width = st.sampled_from([1.0, 1e-2, 1e-4, 1e-7, 1e-9])
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    positions, uv = [], []
    for cell in range(GRID * GRID):
        height, flat = draw(width), draw(width)
        frame, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        corner = rng.uniform(-5, 5, 3)
        positions += [corner, corner + frame[0], corner + 0.4 * frame[0] + height * frame[1]]
        row, column = divmod(cell, GRID)
        origin = np.array([column + 0.1, row + 0.1]) / GRID
        uv += [origin + np.array(offset) / GRID for offset in ([0.0, 0.0], [0.8, 0.0], [0.3, 0.8 * flat])]
    points = np.array(positions)
    faces = np.arange(3 * GRID * GRID, dtype=np.int32).reshape(-1, 3)
    edges = points[faces[:, 1:]] - points[faces[:, :1]]
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return RoomMesh(
        positions=points,
        normals=np.repeat(normals, 3, axis=0),
        uv=np.array(uv),
        faces=faces,
        face_material=np.zeros(len(faces), dtype=np.int32),
        materials=("wall",),
        material_albedo=np.full((1, 3), 0.5),
        uv_source="file",
        content_hash="0123456789abcdef",
    )


@given(meshes())
def test_texels_of_any_triangles(mesh: RoomMesh) -> None:
    texels = rasterise_texels(mesh, ATLAS, rasteriser="cpu")
    corners = mesh.positions[mesh.faces]
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    # Each triangle has texels of its own: in the atlas there is room around every one.
    np.testing.assert_allclose(
        np.bincount(texels.face, weights=texels.area, minlength=len(areas)), areas, rtol=1e-6
    )
    low, high = corners.min(axis=1)[texels.face], corners.max(axis=1)[texels.face]
    assert (texels.position >= low - 1e-6).all()
    assert (texels.position <= high + 1e-6).all()
    np.testing.assert_allclose(np.linalg.norm(texels.normal, axis=1), 1.0, atol=1e-5)
    assert (texels.area > 0.0).all()
