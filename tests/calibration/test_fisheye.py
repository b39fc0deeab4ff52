from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nearfield_calibration.errors import CalibrationError
from nearfield_calibration.fisheye import (
    check_intrinsics,
    first_turning_angle,
    inside_picture,
    pixels_per_steradian,
    project,
    unproject,
)
from nearfield_calibration.models import FisheyeIntrinsics

EQUIDISTANT = FisheyeIntrinsics(
    width=1024,
    height=1024,
    fx=320.0,
    fy=320.0,
    cx=511.5,
    cy=511.5,
    k=(0.0, 0.0, 0.0, 0.0),
    theta_max=math.pi / 2,
)
WIDE = FisheyeIntrinsics(
    width=1280,
    height=960,
    fx=301.0,
    fy=299.0,
    cx=640.2,
    cy=470.9,
    k=(0.03, -0.012, 0.004, -0.0006),
    theta_max=1.75,
)
LENSES = [EQUIDISTANT, replace(EQUIDISTANT, theta_max=math.radians(110)), WIDE]


def random_directions(count: int, theta_max: float, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    theta = np.concatenate([np.linspace(0, theta_max, count), 10.0 ** rng.uniform(-12, -1, count)])
    phi = rng.uniform(-np.pi, np.pi, theta.size)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


@pytest.mark.parametrize("lens", LENSES)
def test_unproject_inverts_project_up_to_the_rim(lens: FisheyeIntrinsics) -> None:
    directions = random_directions(2000, lens.theta_max * (1 - 1e-14))
    pixels, valid = project(directions * 3.7, lens)
    assert valid.all()
    back, back_valid = unproject(pixels, lens)
    assert back_valid.all()
    np.testing.assert_allclose(back, directions, atol=5e-15 * max(lens.width, 1000) / 10)


@pytest.mark.parametrize("lens", LENSES)
def test_project_inverts_unproject_on_every_pixel_of_the_circle(lens: FisheyeIntrinsics) -> None:
    grid = np.stack(np.meshgrid(np.arange(0, lens.width, 7.0), np.arange(0, lens.height, 7.0)), axis=-1)
    directions, valid = unproject(grid, lens)
    pixels, again = project(directions[valid], lens)
    assert again.mean() > 0.999  # pixels exactly on the rim may fall to either side
    np.testing.assert_allclose(pixels[again], grid[valid][again], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(directions[valid], axis=-1), 1.0, atol=1e-15)


@given(theta=st.floats(0, math.pi / 2), phi=st.floats(-math.pi, math.pi))
@settings(max_examples=200, deadline=None)
def test_equidistant_radius_is_focal_length_times_angle(theta: float, phi: float) -> None:
    point = [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]
    pixel, valid = project(point, replace(EQUIDISTANT, theta_max=1.6))
    assert valid
    expected = [511.5 + 320 * theta * math.cos(phi), 511.5 + 320 * theta * math.sin(phi)]
    np.testing.assert_allclose(pixel, expected, atol=1e-9)


def test_agrees_with_opencv_below_85_degrees() -> None:
    directions = random_directions(500, math.radians(85))
    pixels, valid = project(directions, WIDE)
    camera_matrix = np.array([[WIDE.fx, 0, WIDE.cx], [0, WIDE.fy, WIDE.cy], [0, 0, 1]])
    expected, _ = cv2.fisheye.projectPoints(
        directions[None], np.zeros(3), np.zeros(3), camera_matrix, np.array(WIDE.k)
    )
    assert valid.all()
    np.testing.assert_allclose(pixels, expected[0], atol=1e-6)


def test_behind_and_beyond_the_rim_is_invalid_and_nan() -> None:
    pixels, valid = project([[0, 0, -1.0], [0, 0, 0.0], [1.0, 0, -0.01], [np.nan, 0, 1.0]], EQUIDISTANT)
    assert not valid.any()
    assert np.isnan(pixels).all()
    directions, inside = unproject([[0.0, 0.0], [np.inf, 0.0]], EQUIDISTANT)
    assert not inside.any()
    assert np.isnan(directions).all()


def test_beyond_90_degrees_keeps_the_side() -> None:
    lens = replace(EQUIDISTANT, theta_max=math.radians(110))
    theta = math.radians(100)
    pixel, valid = project([math.sin(theta), 0, math.cos(theta)], lens)
    assert valid
    np.testing.assert_allclose(pixel, [511.5 + 320 * theta, 511.5])


def test_axis_maps_to_the_principal_point() -> None:
    pixel, valid = project([0.0, 0.0, 2.0], WIDE)
    assert valid
    np.testing.assert_array_equal(pixel, [WIDE.cx, WIDE.cy])
    direction, inside = unproject([WIDE.cx, WIDE.cy], WIDE)
    assert inside
    np.testing.assert_array_equal(direction, [0.0, 0.0, 1.0])


def test_lens_that_folds_over_is_refused_with_its_angle() -> None:
    # dr/dtheta = 1 - 3 * 0.2 theta^2 is 0 at sqrt(1 / 0.6).
    folded = replace(EQUIDISTANT, k=(-0.2, 0.0, 0.0, 0.0))
    assert first_turning_angle(folded.k) == pytest.approx(math.sqrt(1 / 0.6))
    with pytest.raises(CalibrationError, match=r"stops growing at 1\.29"):
        check_intrinsics(folded)
    check_intrinsics(replace(folded, theta_max=1.29))


@pytest.mark.parametrize(
    "change",
    [{"fx": 0.0}, {"fy": -1.0}, {"theta_max": 90.0}, {"theta_max": 0.0}, {"cx": math.nan}, {"width": 0}],
)
def test_impossible_values_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(CalibrationError):
        project([0, 0, 1.0], replace(EQUIDISTANT, **change))


def test_picture_covers_half_a_pixel_around_the_outer_centres() -> None:
    points = [[-0.5, -0.5], [1023.5, 1023.5], [-0.51, 0], [0, 1023.51], [np.nan, 0]]
    np.testing.assert_array_equal(inside_picture(points, EQUIDISTANT), [True, True, False, False, False])


@pytest.mark.parametrize("lens", LENSES)
def test_pixels_per_steradian_is_the_jacobian_of_the_projection(lens: FisheyeIntrinsics) -> None:
    theta = np.array([1e-3, 0.2, 0.7, 1.2, 1.5])
    step = 1e-5
    at = np.stack([np.sin(theta), np.zeros(5), np.cos(theta)], axis=-1)
    along = np.stack([np.cos(theta), np.zeros(5), -np.sin(theta)], axis=-1)
    across = np.array([0.0, 1.0, 0.0])
    d_along = (project(at + step * along, lens)[0] - project(at - step * along, lens)[0]) / (2 * step)
    d_across = (project(at + step * across, lens)[0] - project(at - step * across, lens)[0]) / (2 * step)
    jacobian = np.abs(d_along[:, 0] * d_across[:, 1] - d_along[:, 1] * d_across[:, 0])
    np.testing.assert_allclose(pixels_per_steradian(theta, lens), jacobian, rtol=1e-6)
