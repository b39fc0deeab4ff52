"""The ground shadow against closed forms: a sphere that touches the plane, a box that stands on it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from nearfield_server.radiometry.sh import sh_basis
from nearfield_server.scene.ground_shadow import compute_ground_shadow, ground_contact
from nearfield_server.scene.ray_caster import RayCaster

RADIUS = 0.2
Y0 = 0.28209479177387814


def sphere(subdivisions: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=RADIUS)
    normals = np.asarray(mesh.vertices) / RADIUS
    return np.asarray(mesh.vertices), normals, np.asarray(mesh.faces)


def sphere_ground_oracle(
    normal: NDArray[np.float64], num_theta: int = 600, num_phi: int = 600
) -> NDArray[np.float64]:
    """Quadrature over the lower hemisphere of a black sphere on a plane: the plane keeps 1 - R^3 / L^3 of its light."""
    cos_theta = (np.arange(num_theta) + 0.5) / num_theta
    phi = (np.arange(num_phi) + 0.5) * 2.0 * np.pi / num_phi
    c, p = np.meshgrid(cos_theta, phi, indexing="ij")
    s = np.sqrt(1.0 - c * c)
    w = np.stack([s * np.cos(p), -c, s * np.sin(p)], axis=-1).reshape(-1, 3)
    start = RADIUS * normal
    reach = (-RADIUS - start[1]) / w[:, 1]
    distance_squared = np.sum((start + reach[:, None] * w)[:, [0, 2]] ** 2, axis=1)
    lost = RADIUS**3 / (distance_squared + RADIUS**2) ** 1.5
    cosine = np.maximum(0.0, w @ normal)
    return (sh_basis(w) * (lost * cosine)[:, None]).sum(axis=0) * 2.0 * np.pi / (num_theta * num_phi)


def test_a_black_sphere_on_the_plane_agrees_with_quadrature() -> None:
    positions, normals, faces = sphere(3)
    ground = compute_ground_shadow(positions, normals, faces, 0.0, samples_per_vertex=1024)
    for vertex in range(0, len(positions), 37):
        if abs(normals[vertex, 1] + 1.0) < 0.05:
            continue  # At the contact point itself the map of the plane is coarser than the gap.
        oracle = sphere_ground_oracle(normals[vertex])
        # 48 map points over four radii and an icosphere a per cent inside the sphere.
        np.testing.assert_allclose(ground[vertex], oracle, atol=0.03)


def test_at_the_contact_point_no_light_of_the_plane_is_left() -> None:
    positions, normals, faces = sphere(3)
    ground = compute_ground_shadow(positions, normals, faces, 0.0, samples_per_vertex=256)
    lowest = int(np.argmin(positions[:, 1]))
    # In a uniform environment of radiance 1 the unshadowed irradiance is pi; SH coefficient C_0 = 1 / Y_0.
    assert ground[lowest, 0] / Y0 == pytest.approx(np.pi, rel=0.05)


def test_surfaces_that_face_up_lose_nothing() -> None:
    positions, normals, faces = sphere(2)
    ground = compute_ground_shadow(positions, normals, faces, 0.6, samples_per_vertex=100)
    assert not ground[normals[:, 1] > 0.999].any()


def test_a_brighter_object_loses_less_because_it_lights_the_plane() -> None:
    positions, normals, faces = sphere(2)
    losses = [
        compute_ground_shadow(positions, normals, faces, albedo, samples_per_vertex=256)[:, 0].sum()
        for albedo in (0.0, 0.4, 0.8)
    ]
    assert losses[0] > losses[1] > losses[2] > 0.0


def test_scale_does_not_matter() -> None:
    positions, normals, faces = sphere(2)
    small = compute_ground_shadow(positions, normals, faces, 0.5, samples_per_vertex=100)
    large = compute_ground_shadow(1000.0 * positions, normals, faces, 0.5, samples_per_vertex=100)
    np.testing.assert_allclose(small, large, atol=1e-2)


FLOOR = (
    np.array([[-5.0, 0.0, -5.0], [-5.0, 0.0, 5.0], [5.0, 0.0, 5.0], [5.0, 0.0, -5.0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)
LOW, HIGH = np.array([-0.1, -0.2, -0.1]), np.array([0.1, 0.2, 0.1])


@pytest.mark.parametrize(("gap", "expected"), [(0.0, 1.0), (0.025, 0.5), (0.2, 0.0), (-0.025, 0.5)])
def test_contact_falls_with_the_gap(gap: float, expected: float) -> None:
    pose = np.eye(4)
    pose[1, 3] = 0.2 + gap
    assert ground_contact(LOW, HIGH, 0.25, pose, RayCaster(*FLOOR)) == pytest.approx(expected, abs=1e-5)


def test_no_contact_beside_the_surface_or_when_tilted() -> None:
    room = RayCaster(*FLOOR)
    beside = np.eye(4)
    beside[:3, 3] = 20.0, 0.2, 0.0
    assert ground_contact(LOW, HIGH, 0.25, beside, room) == 0.0
    tilted = np.eye(4)
    tilted[1:3, 1:3] = [[0.0, -1.0], [1.0, 0.0]]
    tilted[1, 3] = 0.2
    assert ground_contact(LOW, HIGH, 0.25, tilted, room) == 0.0
