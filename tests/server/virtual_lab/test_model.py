from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.virtual_lab.model import fisheye, look_at, tablet


@pytest.mark.parametrize("target", [(1.0, 2.0, 3.0), (-4.0, 0.1, 0.2), (0.1, -3.0, 0.0)])
def test_look_at_is_a_rotation_that_centres_the_target(target: tuple[float, float, float]) -> None:
    eye = (0.3, 0.5, -0.2)
    world_from_camera = look_at(eye, target)
    rotation = world_from_camera[:3, :3]
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    local = np.linalg.inv(world_from_camera) @ [*target, 1.0]
    np.testing.assert_allclose(local[:2], 0.0, atol=1e-13)
    assert local[2] > 0
    assert rotation[1, 1] < 0, "image y points down"
    assert rotation[1, 0] == pytest.approx(0.0), "image x is horizontal"


@pytest.mark.parametrize("k", [(0.0, 0.0, 0.0, 0.0), (0.03, -0.012, 0.004, -0.0006)])
def test_fisheye_circle_touches_the_border(k: tuple[float, float, float, float]) -> None:
    camera = fisheye(64, (0.0, 1.0, 0.0), (1.0, 0.0, 1.0), k)
    theta = np.pi / 2
    radius = theta * (1 + sum(c * theta ** (2 * n + 2) for n, c in enumerate(k)))
    assert camera.cx + camera.fx * radius == pytest.approx(64 - 0.5)
    assert camera.model == ("kannala_brandt" if any(k) else "equidistant")


def test_tablet_field_of_view() -> None:
    view = tablet(96, 54, (0.0, 1.0, 0.0), (1.0, 0.0, 1.0), np.radians(60))
    assert np.arctan2(96 / 2, view.fx) == pytest.approx(np.radians(30))
