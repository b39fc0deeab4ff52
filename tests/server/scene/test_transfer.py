"""Laws of the transfer coefficients: closed forms, sum rules, an independent float64 oracle, convergence."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from nearfield_server.radiometry.sh import clamped_cosine_coeffs, sh_basis
from nearfield_server.scene.transfer import SAMPLES_PER_VERTEX, compute_transfer

Y0 = 0.28209479177387814


def smooth(mesh):
    """Positions, area-weighted unit normals and faces."""
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    cross = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    )
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], cross)
    return vertices, normals / np.linalg.norm(normals, axis=1, keepdims=True), faces


def inward_sphere(radius=1.0, subdivisions=3):
    """Closed spherical cavity seen from inside."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return (
        np.asarray(sphere.vertices),
        -np.asarray(sphere.vertices) / radius,
        np.asarray(sphere.faces)[:, ::-1],
    )


def cup(opening, radius=1.0, rings=48, sectors=96):
    """Inside of a sphere cut off above the polar angle `opening` (from +y): vertex 0 is the bottom."""
    theta = np.linspace(np.pi, opening, rings + 1)[1:]
    phi = np.arange(sectors) * 2 * np.pi / sectors
    t, p = np.meshgrid(theta, phi, indexing="ij")
    rim = np.stack([np.sin(t) * np.cos(p), np.cos(t), np.sin(t) * np.sin(p)], axis=-1).reshape(-1, 3)
    vertices = np.vstack([[0.0, -1.0, 0.0], rim]) * radius
    k = np.arange(sectors)
    n = (k + 1) % sectors
    faces = [np.stack([np.zeros_like(k), 1 + k, 1 + n], axis=1)]
    for ring in range(rings - 1):
        a, b = 1 + ring * sectors, 1 + (ring + 1) * sectors
        faces += [np.stack([a + k, b + k, b + n], axis=1), np.stack([a + k, b + n, a + n], axis=1)]
    faces = np.vstack(faces)
    corners = vertices[faces]
    outward = np.einsum(
        "ij,ij->i",
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]),
        corners.mean(axis=1),
    )
    faces[outward > 0] = faces[outward > 0][:, ::-1]
    return vertices, -vertices / radius, faces


@pytest.mark.parametrize("shape", ["sphere", "box", "capsule"])
def test_convex_bodies_have_the_clamped_cosine_and_no_interreflection(shape):
    mesh = {
        "sphere": lambda: trimesh.creation.icosphere(subdivisions=2, radius=0.3),
        "box": lambda: trimesh.creation.box(extents=(0.4, 0.1, 2.0)),
        "capsule": lambda: trimesh.creation.capsule(height=1.0, radius=0.2, count=(10, 12)),
    }[shape]()
    positions, normals, faces = smooth(mesh)
    transfer = compute_transfer(positions, normals, faces, samples_per_vertex=200)
    np.testing.assert_allclose(transfer.shadowed, clamped_cosine_coeffs(normals), atol=1e-12)
    assert not transfer.bounce1.any()
    assert not transfer.bounce2.any()
    assert transfer.bounce_ratio == 0.0


def test_position_far_from_the_origin_and_scale_do_not_matter():
    positions, normals, faces = smooth(trimesh.creation.torus(0.5, 0.2, major_sections=16, minor_sections=10))
    here = compute_transfer(positions, normals, faces, samples_per_vertex=256)
    there = compute_transfer(positions * 0.01 + [30.0, -20.0, 10.0], normals, faces, samples_per_vertex=256)
    assert np.abs(here.shadowed - there.shadowed).max() < 0.05
    assert np.sqrt(np.mean((here.shadowed - there.shadowed) ** 2)) < 2e-3


@pytest.mark.parametrize("opening_deg", [30.0, 90.0])
def test_bottom_of_a_spherical_cup_sees_the_opening_cone(opening_deg):
    # From the bottom of a sphere the rim at polar angle t appears at angle t / 2 from the axis: E = pi sin^2(t / 2) under
    # constant radiance 1.
    opening = np.radians(opening_deg)
    positions, normals, faces = cup(opening)
    transfer = compute_transfer(positions, normals, faces, samples_per_vertex=4096)
    shadowed = transfer.shadowed[0, 0] * np.sqrt(4 * np.pi)
    assert shadowed == pytest.approx(np.pi * np.sin(opening / 2) ** 2, rel=5e-3)


@pytest.mark.parametrize("albedo", [0.3, 0.8])
def test_hemispherical_cup_under_a_constant_sky_has_the_furnace_irradiance(albedo):
    # In a sphere every patch sees every other with the same form factor dA / (4 pi R^2), so the irradiance from the inside is uniform:
    # with the opening's share s = (1 - cos t) / 2, the mean over the wall of E / pi obeys  mean = s + (1 - s) a mean  for a
    # sky of radiance 1.
    opening = np.radians(60.0)
    positions, normals, faces = cup(opening, rings=24, sectors=48)
    transfer = compute_transfer(positions, normals, faces, samples_per_vertex=1024)
    total = transfer.total(albedo)[:, 0] * np.sqrt(4 * np.pi)
    corners = positions[faces]
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    mean = np.sum(areas * total[faces].mean(axis=1)) / areas.sum()
    share = (1 - np.cos(opening)) / 2
    assert mean == pytest.approx(np.pi * share / (1 - albedo * (1 - share)), rel=0.02)


def test_closed_cavity_is_dark_and_reflects_nothing():
    transfer = compute_transfer(*inward_sphere(), samples_per_vertex=400)
    assert np.abs(transfer.shadowed[:, 0]).max() < 1e-12
    assert np.abs(transfer.shadowed).max() < 0.1
    assert transfer.total(0.9)[:, 0].max() < 1e-12


def test_light_kept_out_and_light_from_the_object_fill_the_hemisphere():
    # An albedo-1 object that everywhere received pi (constant radiance 1) would send radiance 1 back:  shadowed + bounce of pi = pi.
    positions, normals, faces = smooth(trimesh.creation.torus(0.5, 0.2, major_sections=32, minor_sections=16))
    transfer = compute_transfer(positions, normals, faces, samples_per_vertex=2500)
    constant = np.sqrt(4 * np.pi)
    furnace = transfer.total(1.0)[:, 0] * constant
    np.testing.assert_allclose(furnace, np.pi, rtol=0.01)


def test_back_faces_block_but_do_not_reflect():
    # A roof over a floor: turned away from the floor it is black underneath, turned to it it reflects.
    floor = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0, 0.1]])
    roof = np.array([[-3.0, 1, -3], [3, 1, -3], [0, 1, 4]])
    positions = np.vstack([floor, roof])
    up = np.array([[0, 2, 1]])
    for roof_faces, sign in ((np.array([[3, 4, 5]]), -1.0), (np.array([[3, 5, 4]]), 1.0)):
        normals = np.vstack([np.tile([0.0, 1, 0], (3, 1)), np.tile([0.0, sign, 0], (3, 1))])
        transfer = compute_transfer(positions, normals, np.vstack([up, roof_faces]), samples_per_vertex=1024)
        blocked = np.pi / np.sqrt(4 * np.pi) - transfer.shadowed[0, 0]
        assert blocked > 0.5
        assert (transfer.bounce1[0, 0] > 0.0) == (sign < 0)


def test_against_a_brute_force_float64_oracle():
    positions, normals, faces = smooth(trimesh.creation.torus(0.5, 0.22, major_sections=9, minor_sections=7))
    transfer = compute_transfer(positions, normals, faces, samples_per_vertex=4000)
    rng = np.random.default_rng(7)
    for vertex in rng.choice(len(positions), 6, replace=False):
        expected_shadowed, expected_bounce = brute_force(positions, normals, faces, vertex, transfer.shadowed)
        # 40 000 oracle samples: standard error of the blocked part about pi / sqrt(40 000).
        np.testing.assert_allclose(transfer.shadowed[vertex], expected_shadowed, atol=0.03)
        np.testing.assert_allclose(transfer.bounce1[vertex], expected_bounce, atol=0.02)


def brute_force(positions, normals, faces, vertex, radiosity_transfer):
    """Uniform-sphere Monte Carlo with a Moeller-Trumbore test against every triangle, in float64."""
    rng = np.random.default_rng(int(vertex))
    directions = rng.normal(size=(40_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cosine = directions @ normals[vertex]
    directions, cosine = directions[cosine > 0], cosine[cosine > 0]
    origin = positions[vertex] + 1e-5 * normals[vertex]
    nearest = np.full(len(directions), np.inf)
    coeffs = np.zeros((len(directions), 9))
    for face in faces:
        a, b, c = positions[face]
        cross = np.cross(directions, c - a)
        det = cross @ (b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (cross @ (origin - a)) / det
            q = np.cross(origin - a, b - a)
            v = (directions @ q) / det
            t = ((c - a) @ q) / det
        hit = (np.abs(det) > 1e-15) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < nearest)
        nearest[hit] = t[hit]
        front = directions[hit] @ np.cross(b - a, c - a) < 0
        weights = np.stack([1 - u - v, u, v], axis=1)[hit]
        coeffs[hit] = np.where(front[:, None], weights @ radiosity_transfer[face], 0.0)
    seen = np.isinf(nearest)
    scale = 4 * np.pi / 40_000
    shadowed = scale * (cosine[seen] @ sh_basis(directions[seen]))
    bounce = scale / np.pi * (cosine @ np.where(seen[:, None], 0.0, coeffs))
    return shadowed, bounce


def test_converges_at_least_as_fast_as_independent_samples():
    positions, normals, faces = smooth(
        trimesh.creation.torus(0.5, 0.25, major_sections=16, minor_sections=12)
    )
    reference = compute_transfer(positions, normals, faces, samples_per_vertex=40_000, seed=9)
    errors = []
    for count in (100, 400, 1600):
        transfer = compute_transfer(positions, normals, faces, samples_per_vertex=count)
        errors.append(np.sqrt(np.mean((transfer.shadowed - reference.shadowed) ** 2)))
    assert errors[1] < 0.55 * errors[0]
    assert errors[2] < 0.55 * errors[1]


def test_equal_seeds_give_equal_results_and_progress_ends_at_the_end():
    positions, normals, faces = smooth(trimesh.creation.torus(0.5, 0.2, major_sections=8, minor_sections=6))
    calls = []
    first = compute_transfer(
        positions,
        normals,
        faces,
        samples_per_vertex=64,
        progress=lambda done, total: calls.append((done, total)),
    )
    second = compute_transfer(positions, normals, faces, samples_per_vertex=64)
    np.testing.assert_array_equal(first.shadowed, second.shadowed)
    np.testing.assert_array_equal(first.bounce2, second.bounce2)
    assert calls[-1] == (len(positions), len(positions))


def test_total_of_colour_is_the_total_of_each_channel():
    positions, normals, faces = smooth(trimesh.creation.torus(0.5, 0.2, major_sections=8, minor_sections=6))
    transfer = compute_transfer(positions, normals, faces, samples_per_vertex=64)
    colour = np.array([0.2, 0.5, 0.9])
    whole = transfer.total(colour)
    assert whole.shape == (len(positions), 9, 3)
    for channel, albedo in enumerate(colour):
        np.testing.assert_array_equal(whole[..., channel], transfer.total(albedo))
    np.testing.assert_array_equal(transfer.total(0.0), transfer.shadowed)


def test_presets_are_those_of_gierlinger():
    assert SAMPLES_PER_VERTEX == {"preview": 100, "medium": 625, "high": 2500}


@pytest.mark.parametrize("unit", [1, -1])
def test_shadowed_energy_never_exceeds_the_open_hemisphere(unit):
    mesh = trimesh.creation.torus(0.5, 0.2, major_sections=16, minor_sections=10)
    positions, normals, faces = smooth(mesh)
    transfer = compute_transfer(
        positions[:, [0, 1, 2]] * unit, normals * unit, faces[:, ::unit], samples_per_vertex=100
    )
    assert transfer.shadowed[:, 0].max() <= np.pi * Y0 + 1e-12
    assert transfer.shadowed[:, 0].min() >= -1e-12
