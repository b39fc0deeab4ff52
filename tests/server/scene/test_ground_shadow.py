"""The ground shadow against closed forms: a sphere that touches the plane, a box that stands on it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from nearfield_server.radiometry.sh import clamped_cosine_coeffs
from nearfield_server.scene.ground_shadow import compute_ground_shadow, ground_reflectance
from nearfield_server.scene.ray_caster import RayCaster

RADIUS = 0.2
Y0, Y1 = 0.28209479177387814, 0.4886025119029199


def sphere(subdivisions: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=RADIUS)
    normals = np.asarray(mesh.vertices) / RADIUS
    return np.asarray(mesh.vertices), normals, np.asarray(mesh.faces)


def sphere_ground_oracle(
    normal: NDArray[np.float64], num_theta: int = 600, num_phi: int = 600
) -> NDArray[np.float64]:
    """Quadrature over the lower hemisphere of a black sphere on a plane, for light Y_0 to Y_3: (4,).

    A point of the plane at distance L of the centre sees the sphere as a cone of half angle alpha about u, sin alpha = R / L, that
    touches the horizon. With c = cos alpha: integral of w_i w_j over it = a delta_ij + b u_i u_j, a = pi (2/3 - c + c^3 / 3),
    3 a + b = 2 pi (1 - c); and integral of n.w = pi sin^2 alpha n.u.
    """
    cos_theta = (np.arange(num_theta) + 0.5) / num_theta
    phi = (np.arange(num_phi) + 0.5) * 2.0 * np.pi / num_phi
    c, p = np.meshgrid(cos_theta, phi, indexing="ij")
    s = np.sqrt(1.0 - c * c)
    w = np.stack([s * np.cos(p), -c, s * np.sin(p)], axis=-1).reshape(-1, 3)
    start = RADIUS * normal
    reach = (-RADIUS - start[1]) / w[:, 1]
    to_centre = -(start + reach[:, None] * w)
    distance = np.linalg.norm(to_centre, axis=1)
    u = to_centre / distance[:, None]
    cosine = np.sqrt(1.0 - (RADIUS / distance) ** 2)
    a = np.pi * (2.0 / 3.0 - cosine + cosine**3 / 3.0)
    b = 2.0 * np.pi * (1.0 - cosine) - 3.0 * a
    blocked = np.empty((len(w), 4))
    blocked[:, 0] = Y0 * np.pi * (RADIUS / distance) ** 2 * u[:, 1]
    up = np.array([0.0, 1.0, 0.0])
    linear = a[:, None] * up + (b * u[:, 1])[:, None] * u
    blocked[:, 1:] = Y1 * linear[:, [1, 2, 0]]
    seen = np.maximum(0.0, w @ normal)
    return (blocked / np.pi * seen[:, None]).sum(axis=0) * 2.0 * np.pi / (num_theta * num_phi)


def black_sphere(subdivisions: int, samples: int) -> NDArray[np.float64]:
    positions, normals, faces = sphere(subdivisions)
    transfer = clamped_cosine_coeffs(normals)
    return compute_ground_shadow(positions, normals, faces, 0.0, transfer, samples_per_vertex=samples)


def test_a_black_sphere_on_the_plane_agrees_with_quadrature() -> None:
    normals = sphere(3)[1]
    ground = black_sphere(3, 1024)
    for vertex in range(0, len(normals), 37):
        if abs(normals[vertex, 1] + 1.0) < 0.05:
            continue  # At the contact point itself the map of the plane is coarser than the gap.
        # 48 map points over four radii and an icosphere a per cent inside the sphere.
        np.testing.assert_allclose(ground[vertex, :4], sphere_ground_oracle(normals[vertex]), atol=0.03)


def test_light_from_one_side_is_missing_on_the_other() -> None:
    """Light Y_3 (from +x, taken from -x) falls on the plane at -x only behind the sphere."""
    normals = sphere(3)[1]
    ground = black_sphere(3, 256)
    away = ground[(normals[:, 0] < -0.7) & (normals[:, 1] < 0.0), 3].mean()
    towards = ground[(normals[:, 0] > 0.7) & (normals[:, 1] < 0.0), 3].mean()
    assert away > 0.05
    assert towards == pytest.approx(-away, rel=0.05)


def test_at_the_contact_point_no_light_of_the_plane_is_left() -> None:
    positions, _, _ = sphere(3)
    ground = black_sphere(3, 256)
    lowest = int(np.argmin(positions[:, 1]))
    # In a uniform environment of radiance 1 the unshadowed irradiance is pi; SH coefficient C_0 = 1 / Y_0.
    assert ground[lowest, 0] / Y0 == pytest.approx(np.pi, rel=0.05)


def test_surfaces_that_face_up_lose_nothing() -> None:
    positions, normals, faces = sphere(2)
    transfer = clamped_cosine_coeffs(normals)
    ground = compute_ground_shadow(positions, normals, faces, 0.6, transfer, samples_per_vertex=100)
    assert not ground[normals[:, 1] > 0.999].any()


def test_a_brighter_object_loses_less_because_it_lights_the_plane() -> None:
    positions, normals, faces = sphere(2)
    transfer = clamped_cosine_coeffs(normals)
    losses = [
        compute_ground_shadow(positions, normals, faces, albedo, transfer, samples_per_vertex=256)[:, 0].sum()
        for albedo in (0.0, 0.4, 0.8)
    ]
    assert losses[0] > losses[1] > losses[2] > 0.0


def test_scale_does_not_matter() -> None:
    positions, normals, faces = sphere(2)
    transfer = clamped_cosine_coeffs(normals)
    small = compute_ground_shadow(positions, normals, faces, 0.5, transfer, samples_per_vertex=100)
    large = compute_ground_shadow(1000.0 * positions, normals, faces, 0.5, transfer, samples_per_vertex=100)
    np.testing.assert_allclose(small, large, atol=1e-2)


FLOOR = (
    np.array([[-5.0, 0.0, -5.0], [-5.0, 0.0, 5.0], [5.0, 0.0, 5.0], [5.0, 0.0, -5.0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)
FLOOR_ALBEDO = np.array([[0.6, 0.4, 0.2]] * 2)
LOW, HIGH = np.array([-0.1, -0.2, -0.1]), np.array([0.1, 0.2, 0.1])


@pytest.mark.parametrize(("gap", "expected"), [(0.0, 1.0), (0.025, 0.5), (0.2, 0.0), (-0.025, 0.5)])
def test_contact_falls_with_the_gap(gap: float, expected: float) -> None:
    pose = np.eye(4)
    pose[1, 3] = 0.2 + gap
    found = ground_reflectance(LOW, HIGH, 0.25, pose, RayCaster(*FLOOR), FLOOR_ALBEDO)
    np.testing.assert_allclose(found, expected * FLOOR_ALBEDO[0], atol=1e-5)


def test_no_contact_beside_the_surface_or_when_tilted() -> None:
    room = RayCaster(*FLOOR)
    beside = np.eye(4)
    beside[:3, 3] = 20.0, 0.2, 0.0
    assert not ground_reflectance(LOW, HIGH, 0.25, beside, room, FLOOR_ALBEDO).any()
    tilted = np.eye(4)
    tilted[1:3, 1:3] = [[0.0, -1.0], [1.0, 0.0]]
    tilted[1, 3] = 0.2
    assert not ground_reflectance(LOW, HIGH, 0.25, tilted, room, FLOOR_ALBEDO).any()
