from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.virtual_lab.noise import halves_noise, point_noise
from nearfield_server.virtual_lab.render import PointIrradiance


def test_noise_of_the_mean_of_two_halves() -> None:
    """Each half has standard deviation s, so their mean has s / sqrt(2)."""
    halves = 5.0 + 0.2 * np.random.default_rng(1).standard_normal((2, 200, 300, 3))
    result = halves_noise(halves)
    assert result["noise_rms"] == pytest.approx(0.2 / np.sqrt(2), rel=0.01)
    assert result["mean"] == pytest.approx(5.0, rel=1e-3)
    assert result["rel"] == pytest.approx(result["noise_rms"] / result["mean"])


def test_only_selected_pixels_count() -> None:
    halves = np.ones((2, 4, 4, 3))
    halves[0, 0] = 100.0
    selected = np.ones((4, 4), dtype=bool)
    selected[0] = False
    assert halves_noise(halves, selected) == {"noise_rms": 0.0, "mean": 1.0, "rel": 0.0}
    assert halves_noise(halves, np.zeros((4, 4), dtype=bool))["noise_rms"] == 0.0


def test_point_noise_is_relative_to_the_total_of_each_light() -> None:
    direct = np.stack([np.full((50, 2), 3.0), np.full((50, 2), 1.0)])
    indirect = np.full((2, 50, 2, 3), 2.0)
    result = point_noise(PointIrradiance(direct=direct, indirect=indirect))
    np.testing.assert_allclose(result["direct_noise_rel_to_mean_total"], 1.0 / 4.0)
    np.testing.assert_allclose(result["indirect_noise_rel_to_mean_total"], 0.0)
