import numpy as np
import pytest

from nearfield_server.radiometry.form_factor import (
    disc_irradiance_on_axis,
    polygon_irradiance,
    val_irradiance,
)


@pytest.mark.parametrize("distance", [0.01, 0.05, 0.5, 3.0])
def test_disc_term_is_exact_on_the_axis(distance: float) -> None:
    radius, radiance = 0.2, 7.0
    area = np.pi * radius**2
    found = val_irradiance(
        np.zeros((1, 3)), np.array([[0, 1.0, 0]]), np.array([0, distance, 0]), np.array([0, -1.0, 0]),
        np.full(3, radiance * area), area,
    )  # fmt: skip
    np.testing.assert_allclose(found[0], disc_irradiance_on_axis(distance, radius, radiance), rtol=1e-13)


def test_val_is_one_sided_and_finite_at_its_own_position() -> None:
    up, down = np.array([0, 1.0, 0]), np.array([0, -1.0, 0])
    light = np.array([0, 1.0, 0])
    points, normals = np.array([[0, 0, 0], [0, 2.0, 0], [0, 1.0, 0]]), np.array([up, down, up])
    found = val_irradiance(points, normals, light, down, np.ones(3), 0.1)
    assert found[0, 0] == pytest.approx(1.0 / (1.0 + 0.1 / np.pi))
    np.testing.assert_array_equal(found[1:], 0.0)
    behind = val_irradiance(points[:1], -normals[:1], light, down, np.ones(3), 0.0)
    np.testing.assert_array_equal(behind, 0.0)


def test_polygon_matches_the_sum_over_many_small_patches() -> None:
    size, radiance = 0.6, np.array([1.0, 2.0, 3.0])
    corners = np.array(
        [[0, 2, 0], [size, 2, 0], [size, 2, size], [0, 2, size]], dtype=float
    )  # shines downwards
    count = 200
    grid = (np.arange(count) + 0.5) / count * size
    x, z = np.meshgrid(grid, grid)
    patches = np.stack([x.ravel(), np.full(count**2, 2.0), z.ravel()], axis=1)
    point, normal = np.array([0.9, 0.1, -0.4]), np.array([0.1, 0.9, 0.2]) / np.sqrt(0.86)
    offset = patches - point
    squared = (offset**2).sum(axis=1)
    expected = (offset @ normal * offset[:, 1] / squared**2).sum() * (size / count) ** 2 * radiance
    found = polygon_irradiance(point[None], normal[None], corners, radiance)
    np.testing.assert_allclose(found[0], expected, rtol=1e-5)


def test_polygon_does_not_shine_backwards() -> None:
    corners = np.array([[0, 2, 0], [1, 2, 0], [1, 2, 1], [0, 2, 1]], dtype=float)
    above = polygon_irradiance(np.array([[0.5, 3.0, 0.5]]), np.array([[0, -1.0, 0]]), corners, np.ones(3))
    np.testing.assert_array_equal(above, 0.0)


def test_polygon_fills_the_hemisphere() -> None:
    corners = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], dtype=float) * 1e4
    found = polygon_irradiance(np.array([[0, -1e-2, 0]]), np.array([[0, 1.0, 0]]), corners, np.full(3, 5.0))
    np.testing.assert_allclose(found, 5.0 * np.pi, rtol=1e-6)


def test_polygon_below_the_horizon_is_refused() -> None:
    corners = np.array([[0, 1, 0], [0, 1, 1], [0, -1, 1], [0, -1, 0]], dtype=float)
    receiver = np.array([[1.0, 0, 0.5]])
    with pytest.raises(ValueError, match="horizon"):
        polygon_irradiance(
            np.repeat(receiver, 2, 0) * [[1, 1, 1], [-1, 1, 1]],
            np.array([[0, 1.0, 0]] * 2),
            corners,
            np.ones(3),
        )
