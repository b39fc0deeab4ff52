"""Light to codes: mean, noise, full well and ends of the range, against float64."""

from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.capture.sensor_model import SensorModel
from nearfield_server.virtual_camera.sensor import Readout, expected_codes, expose, noise_tile

SENSOR = SensorModel(full_well_radiance=2.0, full_well_electrons=8000.0, read_noise_electrons=4.0)


def exposed(light: np.ndarray, readout: Readout, frame: int = 0, sensor: SensorModel = SENSOR) -> np.ndarray:
    codes = np.empty(light.shape, np.uint16)
    expose(light, sensor, readout, frame, codes)
    return codes


@pytest.mark.parametrize("gain", [1.0, 4.0])
@pytest.mark.parametrize("radiance", [0.5, 5.0, 40.0])
def test_mean_and_variance_are_those_of_photons_and_read_noise(radiance: float, gain: float) -> None:
    readout = Readout(exposure_s=0.01, gain=gain, black_level=64.0)
    light = np.full((256, 512), radiance, np.float32)
    codes = exposed(light, readout).astype(np.float64)
    mean, deviation = expected_codes(light[:1, :1].astype(np.float64), SENSOR, readout)
    # Rounding adds a twelfth of a code to the variance. Rows share one tile of noise: the mean of 131072 pixels that start at 256
    # places of it is as good as that of 512 independent ones at worst.
    assert abs(codes.mean() - mean[0, 0]) < 4.0 * deviation[0, 0] / np.sqrt(512)
    assert codes.var() == pytest.approx(deviation[0, 0] ** 2 + 1.0 / 12.0, rel=4.0 * np.sqrt(2.0 / 512))


def test_without_noise_codes_are_the_rounded_mean() -> None:
    quiet = SensorModel(full_well_radiance=2.0, full_well_electrons=1e12, read_noise_electrons=0.0)
    light = np.linspace(0.0, 250.0, 4096, dtype=np.float32).reshape(16, 256)
    readout = Readout(exposure_s=0.01, gain=0.5, black_level=16.0)
    mean, _ = expected_codes(light.astype(np.float64), quiet, readout)
    # Float32 carries 24 bits; photon noise of 1e12 electrons is a millionth.
    assert np.abs(exposed(light, readout, sensor=quiet) - mean).max() <= 0.5 + 4096 * 1e-5


def test_twice_the_exposure_is_twice_the_light() -> None:
    light = np.random.default_rng(2).random((8, 64))
    long = expected_codes(light, SENSOR, Readout(exposure_s=0.02, black_level=10.0))[0] - 10.0
    bright = expected_codes(2.0 * light, SENSOR, Readout(exposure_s=0.01, black_level=10.0))[0] - 10.0
    assert np.allclose(long, bright, rtol=1e-14)


def test_a_full_well_ends_at_the_top_code_and_gain_makes_it_end_earlier() -> None:
    light = np.array([[0.0, 199.0, 250.0, 1e30]], np.float32)
    codes = exposed(light, Readout(exposure_s=0.01, bits=12))
    assert codes[0, 2] == codes[0, 3] == 4095
    assert codes[0, 0] < 16
    # A gain of a half leaves the upper half of the codes unused: the well is full before.
    assert exposed(light, Readout(exposure_s=0.01, gain=0.5, bits=12))[0, 3] in (2047, 2048)
    assert exposed(light, Readout(exposure_s=0.01, gain=4.0, bits=12))[0, 1] == 4095


def test_noise_differs_between_pictures_rows_and_cameras_and_can_be_repeated() -> None:
    light = np.full((4, 512), 40.0, np.float32)
    readout = Readout(exposure_s=0.01)
    first = exposed(light, readout, 1)
    assert np.array_equal(first, exposed(light, readout, 1))
    assert not np.array_equal(first, exposed(light, readout, 2))
    assert not np.array_equal(first[0], first[1])
    other = SensorModel(full_well_radiance=2.0, full_well_electrons=8000.0, read_noise_electrons=4.0, seed=2)
    assert not np.array_equal(first, exposed(light, readout, 1, other))
    pair = np.stack([exposed(np.full((256, 512), 40.0, np.float32), readout, frame) for frame in (1, 2)])
    correlation = np.corrcoef(pair.reshape(2, -1))[0, 1]
    assert abs(correlation) < 4.0 / np.sqrt(512)


def test_the_tile_of_noise_is_standard_normal() -> None:
    tile = noise_tile(1).astype(np.float64)
    assert abs(tile.mean()) < 1e-6
    assert tile.var() == pytest.approx(1.0, abs=1e-6)
    # Kurtosis of a normal distribution; its estimate from n numbers deviates by sqrt(24 / n).
    assert (tile**4).mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(24.0 / len(tile)))
