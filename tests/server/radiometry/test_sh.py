import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

from nearfield_server.radiometry.cube import cube_directions, cube_solid_angles
from nearfield_server.radiometry.sh import (
    CLAMPED_COSINE,
    clamped_cosine_coeffs,
    irradiance,
    project_samples,
    rotate_sh,
    rotation_matrix,
    sh_basis,
    sh_basis_into,
)


def test_basis_is_the_real_form_of_the_complex_harmonics() -> None:
    directions = cube_directions(3)
    theta, phi = np.arccos(directions[:, 2]), np.arctan2(directions[:, 1], directions[:, 0])
    expected = np.empty((directions.shape[0], 9))
    for band in range(3):
        for order in range(-band, band + 1):
            value = sph_harm_y(band, abs(order), theta, phi) * (-1.0) ** order  # undo Condon-Shortley
            part = value.real if order >= 0 else value.imag
            expected[:, band * band + band + order] = part * (1.0 if order == 0 else np.sqrt(2.0))
    np.testing.assert_allclose(sh_basis(directions), expected, atol=1e-14)


def test_basis_is_orthonormal_on_the_cube() -> None:
    directions, weights = cube_directions(128), cube_solid_angles(128)
    basis = sh_basis(directions)
    np.testing.assert_allclose(basis.T @ (basis * weights[:, None]), np.eye(9), atol=2e-4)


def test_kernel_form_equals_array_form() -> None:
    out = np.empty(9)
    for direction in cube_directions(2):
        sh_basis_into(*direction, out)
        np.testing.assert_array_equal(out, sh_basis(direction))


def test_constant_radiance_has_only_band_zero_and_irradiance_pi() -> None:
    directions, weights = cube_directions(64), cube_solid_angles(64)
    coeffs = project_samples(directions, weights, np.full((directions.shape[0], 3), 2.0))
    assert coeffs[0] == pytest.approx(2.0 * np.sqrt(4.0 * np.pi), rel=1e-12)
    np.testing.assert_allclose(irradiance(coeffs, cube_directions(1)), 2.0 * np.pi, rtol=1e-3)


def test_clamped_cosine_coefficients_match_their_integral() -> None:
    directions, weights = cube_directions(256), cube_solid_angles(256)
    normal = np.array([0.48, -0.6, 0.64])
    integral = project_samples(directions, weights, np.maximum(directions @ normal, 0.0))
    np.testing.assert_allclose(clamped_cosine_coeffs(normal), integral, atol=1e-4)
    np.testing.assert_allclose(CLAMPED_COSINE[[0, 1, 4]], [np.pi, 2 * np.pi / 3, np.pi / 4])


@pytest.mark.parametrize("seed", range(5))
def test_rotation_moves_the_function(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(rng=rng).as_matrix()
    coeffs = rng.normal(size=(9, 3))
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rotated = rotate_sh(coeffs, rotation)
    np.testing.assert_allclose(
        sh_basis(directions @ rotation.T) @ rotated, sh_basis(directions) @ coeffs, atol=1e-12
    )


def test_rotations_form_a_group() -> None:
    first, second = Rotation.random(2, rng=np.random.default_rng(3)).as_matrix()
    np.testing.assert_allclose(rotation_matrix(np.eye(3)), np.eye(9), atol=1e-14)
    np.testing.assert_allclose(
        rotation_matrix(first @ second), rotation_matrix(first) @ rotation_matrix(second), atol=1e-13
    )
    np.testing.assert_allclose(rotation_matrix(first.T), rotation_matrix(first).T, atol=1e-13)
