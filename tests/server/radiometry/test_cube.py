import numpy as np
import pytest

from nearfield_server.radiometry.cube import cube_directions, cube_solid_angles


@pytest.mark.parametrize("resolution", [1, 2, 7, 32, 64])
def test_solid_angles_cover_the_sphere_exactly(resolution: int) -> None:
    angles = cube_solid_angles(resolution)
    assert angles.shape == (6 * resolution**2,)
    assert angles.sum() == pytest.approx(4.0 * np.pi, rel=1e-13)
    assert (angles > 0.0).all()


def test_small_pixels_agree_with_the_midpoint_rule() -> None:
    resolution = 256
    directions = cube_directions(resolution)
    # Solid angle of a small patch on the face at distance 1: area * cos^3.
    cosine = np.abs(directions).max(axis=1)
    np.testing.assert_allclose(cube_solid_angles(resolution), (2.0 / resolution) ** 2 * cosine**3, rtol=1e-4)


def test_faces_are_in_order_and_unit() -> None:
    directions = cube_directions(5).reshape(6, 25, 3)
    for face in range(6):
        axis, sign = face // 2, 1.0 - 2.0 * (face % 2)
        assert (np.abs(directions[face]).argmax(axis=1) == axis).all()
        assert (directions[face, :, axis] * sign > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, rtol=1e-14)


def test_directions_and_angles_belong_together() -> None:
    # The integral of d d^T over the sphere is 4 pi / 3 times the identity.
    directions, angles = cube_directions(64), cube_solid_angles(64)
    np.testing.assert_allclose(
        directions.T @ (directions * angles[:, None]), np.eye(3) * 4 * np.pi / 3, atol=1e-3
    )


def test_refuses_no_pixels() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        cube_directions(0)
