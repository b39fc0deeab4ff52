"""The ratio of two exposures from their pixels: how exact, and what does not disturb it."""

from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.imaging.development import Developer
from nearfield_server.imaging.exposure_check import exposure_ratio
from nearfield_server.imaging.pixel_formats import FORMATS
from nearfield_server.imaging.response import Response, make_response
from nearfield_server.scene.device_schema import SensorTable


def _scene(rng: np.random.Generator, side: int = 256) -> np.ndarray:
    """A room with a range of 10^4: smooth shades, texture, two lamps."""
    rows, columns = np.mgrid[0:side, 0:side] / side
    shade = 0.5 * np.exp(-3.0 * rows + 2.0 * np.sin(3 * columns)) * rng.uniform(0.7, 1.0, (side, side))
    shade[20:50, 60:100] = 300.0
    return shade


def _expose(rng: np.random.Generator, radiance: np.ndarray, amount: float, black: float = 60.0) -> np.ndarray:
    electrons = rng.poisson(np.minimum(radiance * amount * 10_000, 1e6)) + rng.normal(0, 3, radiance.shape)
    codes = np.rint(black + np.minimum(electrons, 10_000) * ((4095 - black) / 10_000))
    return np.clip(codes, 0, 4095).astype(np.uint16)


def _ratio(first: np.ndarray, second: np.ndarray, response: Response | None = None) -> float:
    response = response or make_response(SensorTable(black_level=60.0), FORMATS["Mono12"])
    return exposure_ratio(first, second, response.lookup, response.saturated_from, response.step)


@pytest.mark.parametrize("true", [2.0, 4.0, 8.0, 16.0])
@pytest.mark.parametrize("longest", [0.5, 2.0, 20.0])
def test_the_ratio_is_exact_within_noise_either_way_round(true: float, longest: float) -> None:
    rng = np.random.default_rng(3)
    scene = _scene(rng)
    longer, shorter = _expose(rng, scene, longest), _expose(rng, scene, longest / true)
    # 65 000 pixels; a million, as cameras have, are four times as exact.
    assert _ratio(longer, shorter) == pytest.approx(true, rel=3e-3)
    assert _ratio(shorter, longer) == pytest.approx(1 / true, rel=3e-3)


def test_a_lamp_switched_between_the_exposures_does_not_move_it() -> None:
    rng = np.random.default_rng(4)
    scene = _scene(rng)
    other = scene.copy()
    other[:, 180:] *= 3.0  # lights up a quarter of the room
    assert _ratio(_expose(rng, scene, 1.0), _expose(rng, other, 1 / 8)) == pytest.approx(8.0, rel=0.02)


def test_pictures_that_share_nothing_have_no_ratio() -> None:
    full, black = np.full((64, 64), 4095, np.uint16), np.full((64, 64), 60, np.uint16)
    assert np.isnan(_ratio(full, black))
    assert np.isnan(_ratio(full, full))
    assert np.isnan(_ratio(black, black))


def test_the_developer_compares_each_with_each() -> None:
    rng = np.random.default_rng(5)
    scene = _scene(rng)
    developer = Developer(SensorTable(black_level=60.0), "BayerGB12", 256, 256)
    amounts = [1.0, 0.1, 0.02, 0.004]
    for position, amount in enumerate(amounts):
        developer.keep(position, _expose(rng, scene, amount).astype("<u2").view(np.uint8).reshape(-1), 0)
    found = developer.ratios(4)
    assert [(i, j) for i, j, _ in found] == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    for i, j, ratio in found:
        assert np.isnan(ratio) or ratio == pytest.approx(amounts[i] / amounts[j], rel=0.02)
    assert np.isfinite([ratio for i, j, ratio in found if j == i + 1]).all()
