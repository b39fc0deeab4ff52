"""Image circles that are known, drawn with noise, cut and darkened; and those of the pictures of a path-traced room."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nearfield_server.onboarding.lens_guess import default_lens, find_image_circle, guess_lens, with_field
from nearfield_server.scene.exr import read_exr
from nearfield_server.scene.room_config import LabSourceConfig, load_room

LAB_ROOM = Path(__file__).parents[3] / "server" / "nearfield_server" / "rooms" / "lab"


def _picture(
    height: int, width: int, x: float, y: float, radius: float, *, seed: int = 1, noise: float = 0.5
) -> np.ndarray:
    """Codes of a room seen through a lens: darker towards the rim, with a black level and noise everywhere."""
    rows, columns = np.mgrid[0:height, 0:width]
    distance = np.hypot(columns - x, rows - y)
    rng = np.random.default_rng(seed)
    room = 60.0 + 40.0 * np.sin(columns / 37.0) * np.cos(rows / 23.0)
    signal = np.where(distance <= radius, room * (1.0 - 0.6 * (distance / radius) ** 2), 0.0)
    return 4.0 + signal + noise * rng.standard_normal((height, width))


@pytest.mark.parametrize(
    ("height", "width", "x", "y", "radius"),
    [
        (480, 640, 320.0, 240.0, 200.0),
        (1024, 1024, 530.3, 498.7, 470.2),
        (300, 400, 190.5, 160.25, 120.0),
        (480, 640, 322.0, 236.0, 290.0),  # cut above and below
        (1200, 1920, 960.0, 640.0, 800.0),
    ],
)
def test_circles_are_found(height: int, width: int, x: float, y: float, radius: float) -> None:
    found = find_image_circle(_picture(height, width, x, y, radius))
    assert found is not None
    tolerance = 0.006 * radius
    assert found.x == pytest.approx(x, abs=tolerance)
    assert found.y == pytest.approx(y, abs=tolerance)
    assert found.radius == pytest.approx(radius, abs=tolerance)


def test_dark_walls_and_stray_light_do_not_move_it() -> None:
    picture = _picture(600, 600, 300.0, 310.0, 260.0)
    rows, columns = np.mgrid[0:600, 0:600]
    angle = np.arctan2(rows - 310.0, columns - 300.0)
    picture[(angle > 0.3) & (angle < 1.5)] = 4.0  # a black curtain
    picture[10:16, 500:506] = 90.0  # a reflection in the lens
    found = find_image_circle(picture)
    assert found is not None
    assert (found.x, found.y, found.radius) == pytest.approx((300.0, 310.0, 260.0), abs=2.5)


@pytest.mark.parametrize("seed", range(3))
def test_pictures_without_a_rim(seed: int) -> None:
    rng = np.random.default_rng(seed)
    dark = 4.0 + rng.standard_normal((300, 400))
    assert find_image_circle(dark) is None
    assert find_image_circle(np.zeros((300, 400))) is None
    lit_everywhere = 100.0 + 20.0 * rng.standard_normal((300, 400))
    assert find_image_circle(lit_everywhere) is None
    window = dark.copy()
    window[100:180, 50:220] = 100.0  # a rectangle is no circle
    assert find_image_circle(window) is None


def test_the_lens_ends_where_the_circle_does() -> None:
    lens, is_found = guess_lens(_picture(480, 640, 330.0, 235.0, 200.0), field_degrees=190.0)
    assert is_found
    assert lens.theta_max == pytest.approx(math.radians(95))
    assert lens.fx * lens.theta_max == pytest.approx(200.0, abs=1.2)
    assert (lens.width, lens.height, lens.k) == (640, 480, (0.0, 0.0, 0.0, 0.0))
    wide, _ = guess_lens(_picture(480, 640, 330.0, 235.0, 200.0))
    assert with_field(wide, 190.0) == replace(lens, fx=pytest.approx(lens.fx), fy=pytest.approx(lens.fy))
    unknown, is_found = guess_lens(np.zeros((480, 640)))
    assert not is_found
    assert unknown == default_lens(640, 480)
    assert unknown.fx * math.pi / 2 == pytest.approx(320.0)
    assert (unknown.cx, unknown.cy) == (319.5, 239.5)


def test_lenses_of_the_lab_are_guessed_from_its_pictures() -> None:
    room = load_room(LAB_ROOM)
    camera, source = room.cameras[0], room.sources[0]
    assert isinstance(source, LabSourceConfig)
    picture = sum(read_exr(file).astype(np.float64).mean(axis=-1) for file in source.files)
    truth = camera.intrinsics
    lens, is_found = guess_lens(np.asarray(picture), math.degrees(2 * truth.theta_max))
    assert is_found
    assert lens.fx == pytest.approx(truth.fx, rel=0.01)
    assert (lens.cx, lens.cy) == pytest.approx((truth.cx, truth.cy), abs=0.01 * truth.width)
