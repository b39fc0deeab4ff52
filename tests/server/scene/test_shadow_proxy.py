"""The shadow proxy keeps to the surface, and its error bound is honest."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from nearfield_server.scene.shadow_proxy import MAX_FACES, distance_to_mesh, make_shadow_proxy


def test_small_models_are_used_as_they_are():
    box = trimesh.creation.box(extents=(1, 2, 3))
    proxy = make_shadow_proxy(np.asarray(box.vertices), np.asarray(box.faces))
    assert proxy.hausdorff == 0.0
    assert len(proxy.faces) == 12
    assert trimesh.Trimesh(proxy.positions, proxy.faces, process=False).volume == pytest.approx(6.0)


def test_large_models_become_a_few_hundred_faces_close_to_the_surface():
    torus = trimesh.creation.torus(0.5, 0.2, major_sections=96, minor_sections=48)
    positions, faces = np.asarray(torus.vertices) + np.array([5.0, 0, 0]), np.asarray(torus.faces)
    proxy = make_shadow_proxy(positions, faces)
    assert 100 < len(proxy.faces) <= MAX_FACES
    assert 0.0 < proxy.hausdorff < 0.05 * 0.7
    assert distance_to_mesh(positions, proxy.positions, proxy.faces).max() <= proxy.hausdorff


def test_seams_are_welded_before_decimation():
    sphere = trimesh.creation.icosphere(subdivisions=4)
    faces = np.asarray(sphere.faces)
    split = np.asarray(sphere.vertices)[faces.reshape(-1)]
    proxy = make_shadow_proxy(split, np.arange(faces.size).reshape(-1, 3))
    assert len(proxy.faces) <= MAX_FACES
    assert trimesh.Trimesh(proxy.positions, proxy.faces, process=True).is_watertight
    assert proxy.hausdorff < 0.05


def test_distance_to_a_triangle_in_every_region():
    triangle = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]])
    points = np.array([[0.5, 0.5, 3], [-1, -1, 0], [1, -2, 0], [3, 0, 0], [2, 2, 0], [0.2, 0.2, 0]])
    np.testing.assert_allclose(
        distance_to_mesh(points, triangle, np.array([[0, 1, 2]])),
        [3, np.sqrt(2), 2, 1, np.sqrt(2), 0],
        atol=1e-12,
    )


def test_distance_agrees_with_a_dense_sampling_of_the_surface():
    rng = np.random.default_rng(3)
    mesh = trimesh.creation.icosphere(subdivisions=1)
    points = rng.normal(size=(40, 3)) * 1.5
    weights = rng.dirichlet([1, 1, 1], size=4000)
    surface = np.einsum("sk,fkj->fsj", weights, mesh.vertices[mesh.faces]).reshape(-1, 3)
    sampled = np.array([np.linalg.norm(surface - p, axis=1).min() for p in points])
    exact = distance_to_mesh(points, np.asarray(mesh.vertices), np.asarray(mesh.faces))
    assert np.all(exact <= sampled + 1e-12)
    np.testing.assert_allclose(exact, sampled, atol=0.02)
