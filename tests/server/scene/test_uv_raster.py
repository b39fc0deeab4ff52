from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from nearfield_server.scene.uv_raster import cover_texels


def test_triangulated_square_covers_every_texel_once() -> None:
    # Random triangulations of the unit square: every centre belongs to exactly one triangle.
    rng = np.random.default_rng(5)
    for count in (4, 20, 300):
        inner = rng.uniform(0, 1, (count, 2))
        uv = np.concatenate([[[0, 0], [1, 0], [1, 1], [0, 1]], inner])
        faces = Delaunay(uv).simplices.astype(np.int32)
        coverage = cover_texels(uv, faces, 64, 48)
        assert (coverage.face >= 0).all()
        assert coverage.num_overlaps == 0


@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.sampled_from([(16, 16), (31, 17)]),
)
@settings(max_examples=60, deadline=None)
def test_vertices_on_texel_centres_and_borders_still_partition(seed: int, size: tuple[int, int]) -> None:
    # Multiples of half a texel put edges exactly through centres: the tie rule decides.
    height, width = size
    rng = np.random.default_rng(seed)
    grid = rng.integers(0, 2 * np.array([width, height]) + 1, (12, 2)) / 2.0 / [width, height]
    uv = np.unique(np.concatenate([[[0, 0], [1, 0], [1, 1], [0, 1]], grid]), axis=0)
    faces = Delaunay(uv).simplices.astype(np.int32)
    flipped = faces.copy()
    flipped[::2] = flipped[::2, ::-1]
    coverage = cover_texels(uv, faces, height, width)
    assert (coverage.face >= 0).all()
    np.testing.assert_array_equal(cover_texels(uv, flipped, height, width).face, coverage.face)
    # One triangle at a time: exactly one claims each centre.
    claims = sum((cover_texels(uv, face[None], height, width).face >= 0).astype(int) for face in faces)
    np.testing.assert_array_equal(claims, 1)


def test_top_and_left_edges_own_centres_that_lie_on_them() -> None:
    # A rectangle from centre (2, 1) to centre (5, 3) in texels: first row and column are in, last ones are not.
    corners = np.array([[2.5, 1.5], [5.5, 1.5], [5.5, 3.5], [2.5, 3.5]]) / 8
    face = cover_texels(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), 8, 8).face
    expected = np.zeros((8, 8), dtype=bool)
    expected[1:3, 2:5] = True
    np.testing.assert_array_equal(face >= 0, expected)


@pytest.mark.parametrize("shift", [0.0, 0.2])
def test_overlapping_charts_are_found_and_shared_borders_are_not(shift: float) -> None:
    square = np.array([[0.1, 0.1], [0.5, 0.1], [0.5, 0.5], [0.1, 0.5]])
    uv = np.concatenate([square, square + np.array([0.4 - shift, 0.0])])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.int32)
    coverage = cover_texels(uv, faces, 50, 50)
    # 0.2 x 0.4 of a 50 x 50 atlas, without the 10 centres on the diagonal of either square (deep inside no triangle).
    assert coverage.num_overlaps == (0 if shift == 0 else 200 - 20)


def test_parts_outside_and_flat_triangles_cover_nothing() -> None:
    uv = np.array([[-1e9, -1.0], [-0.5, -0.5], [-1.0, 0.5], [0.2, 0.2], [0.8, 0.8], [0.5, 0.5]])
    face = cover_texels(uv, np.array([[0, 1, 2], [3, 4, 5]], np.int32), 16, 16).face
    assert (face == -1).all()
