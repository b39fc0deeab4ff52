"""The simulated sensor against its own statistics."""

from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.capture.sensor_model import SensorModel, simulate_sensor
from nearfield_server.errors import ConfigError

SENSOR = SensorModel(
    full_well_radiance=10.0, full_well_electrons=10_000.0, read_noise_electrons=5.0, bits=14, seed=3
)


def test_mean_and_variance_are_those_of_photons_and_read_noise() -> None:
    count = 200_000
    measured, saturated = simulate_sensor(np.full((1, count, 3), 2.0, np.float32), SENSOR, 0)
    assert saturated == 0
    electrons = measured.astype(np.float64) * 1000.0
    step = 10_000.0 / (2**14 - 1)
    variance = 2000.0 + 5.0**2 + step**2 / 12
    samples = electrons.size
    assert abs(electrons.mean() - 2000.0) < 5 * np.sqrt(variance / samples)
    assert abs(electrons.var() / variance - 1) < 5 * np.sqrt(2 / samples)


def test_saturation_clips_at_the_full_well_and_is_counted() -> None:
    picture = np.full((4, 4, 3), 1.0, np.float32)
    picture[1, 2, 0] = 5000.0
    picture[3] = 60_000.0
    measured, saturated = simulate_sensor(picture, SENSOR, 0)
    assert saturated == 5
    assert measured.max() == np.float32(10.0)
    assert (measured[3] == np.float32(10.0)).all()


def test_values_lie_on_the_codes_of_the_converter() -> None:
    sensor = SensorModel(full_well_radiance=3.0, bits=8)
    rng = np.random.default_rng(0)
    measured, _ = simulate_sensor(rng.uniform(0, 4, (32, 32, 3)).astype(np.float32), sensor, 1)
    codes = measured.astype(np.float64) / 3.0 * 255
    np.testing.assert_allclose(codes, np.rint(codes), atol=1e-4)


def test_noise_is_a_function_of_seed_and_frame() -> None:
    picture = np.full((8, 8, 3), 1.0, np.float32)
    first = simulate_sensor(picture, SENSOR, 5)[0]
    np.testing.assert_array_equal(first, simulate_sensor(picture, SENSOR, 5)[0])
    assert (first != simulate_sensor(picture, SENSOR, 6)[0]).any()
    other = SensorModel(full_well_radiance=10.0, bits=14, read_noise_electrons=5.0, seed=4)
    assert (first != simulate_sensor(picture, other, 5)[0]).any()


def test_noise_is_normal_and_independent_between_pixels_channels_and_frames() -> None:
    """Fourth moment and correlations, within five standard deviations of their estimates."""
    count = 150_000
    frames = [
        simulate_sensor(np.full((1, count, 3), 5.0, np.float32), SENSOR, frame)[0][0].astype(np.float64)
        for frame in (0, 1)
    ]
    first, second = [(frame - frame.mean()) / frame.std() for frame in frames]
    assert abs((first**4).mean() - 3.0) < 5 * np.sqrt(96 / first.size)
    assert abs((first**3).mean()) < 5 * np.sqrt(15 / first.size)
    limit = 5 / np.sqrt(count)
    for lag in (1, 2, 32, 1024):
        assert abs((first[lag:] * first[:-lag]).mean(axis=0)).max() < limit * 1.02
    for left, right in ((0, 1), (0, 2), (1, 2)):
        assert abs((first[:, left] * first[:, right]).mean()) < limit
        assert abs((first[:, left] ** 2 * first[:, right] ** 2).mean() - 1.0) < 2 * limit
    assert abs((first * second).mean(axis=0)).max() < limit


@pytest.mark.parametrize(
    "wrong",
    [
        {"full_well_radiance": 0.0},
        {"full_well_radiance": 1.0, "bits": 4},
        {"full_well_radiance": float("nan")},
    ],
)
def test_impossible_sensors_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="sensor"):
        SensorModel(**wrong)  # type: ignore[arg-type]
