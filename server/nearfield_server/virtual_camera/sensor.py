"""Light to codes, fast: the sensor of `capture/sensor_model.py` with exposure, gain and black level, for a simulated camera."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.capture.sensor_model import SensorModel

_NOISE_TILE: Final = 1 << 18
_ROW_MULTIPLIER: Final = np.uint64(0x9E3779B97F4A7C15)
_MIX_MULTIPLIER: Final = np.uint64(0xBF58476D1CE4E5B9)


@dataclass(frozen=True, slots=True, kw_only=True)
class Readout:
    """How one picture is exposed and read out.

    Attributes:
        exposure_s: exposure time, seconds.
        gain: linear, between the pixel and the converter.
        black_level: code of a dark pixel.
        bits: of the converter.
    """

    exposure_s: float
    gain: float = 1.0
    black_level: float = 0.0
    bits: int = 12


@cache
def noise_tile(seed: int) -> NDArray[np.float32]:
    """(2^18,) float32 normal numbers of mean 0 and variance 1; every row of every picture takes its noise from another place of them."""
    tile = np.random.Generator(np.random.Philox(seed)).standard_normal(_NOISE_TILE)
    tile -= tile.mean()
    normal: NDArray[np.float32] = (tile / tile.std()).astype(np.float32)
    return normal


@njit(cache=True, nogil=True, fastmath=True)  # type: ignore[untyped-decorator]
def _expose_row(
    light: NDArray[np.float32],
    noise: NDArray[np.float32],
    electrons_per_light: np.float32,
    full_well: np.float32,
    read_variance: np.float32,
    codes_per_electron: np.float32,
    black_level: np.float32,
    top_code: np.float32,
    out: NDArray[np.uint16],
) -> None:
    for pixel in range(light.shape[0]):
        expected = light[pixel] * electrons_per_light
        electrons = expected + np.sqrt(expected + read_variance) * noise[pixel]
        code = min(electrons, full_well) * codes_per_electron + black_level
        out[pixel] = np.uint16(min(max(code, np.float32(0.0)), top_code) + np.float32(0.5))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _expose_rows(
    light: NDArray[np.float32],
    noise: NDArray[np.float32],
    key: np.uint64,
    electrons_per_light: np.float32,
    full_well: np.float32,
    read_variance: np.float32,
    codes_per_electron: np.float32,
    black_level: np.float32,
    top_code: np.float32,
    out: NDArray[np.uint16],
) -> None:
    """Rows (R, N) of light to codes; the noise of a row starts at a place of the tile that a hash of picture and row gives."""
    span = np.uint64(noise.shape[0] - light.shape[1])
    for row in range(light.shape[0]):
        word = (key + np.uint64(row)) * _ROW_MULTIPLIER
        word = (word ^ (word >> np.uint64(30))) * _MIX_MULTIPLIER
        start = np.int64((word ^ (word >> np.uint64(27))) % span)
        _expose_row(
            light[row],
            noise[start : start + light.shape[1]],
            electrons_per_light,
            full_well,
            read_variance,
            codes_per_electron,
            black_level,
            top_code,
            out[row],
        )


def expose(
    light: NDArray[np.float32], sensor: SensorModel, readout: Readout, frame: int, out: NDArray[np.uint16]
) -> None:
    """Expose, add photon and read noise, fill up, amplify, quantise.

    A full well fills the code range above the black level at a gain of 1.

    Args:
        light: (H, W) or (H, W, 3) float32 radiance of each photodiode, finite and >= 0, contiguous; W times channels at most 2^16.
        sensor: `full_well_radiance` is that of one second.
        readout: exposure, gain, black level and bits; the bits of `sensor` are not used.
        frame: selects the noise; the same number gives the same noise.
        out: like `light`, uint16, written completely.
    """
    rows = light.reshape(len(light), -1)
    top_code = float(2**readout.bits - 1)
    _expose_rows(
        rows,
        noise_tile(sensor.seed),
        np.uint64(frame) << np.uint64(20),
        np.float32(sensor.full_well_electrons * readout.exposure_s / sensor.full_well_radiance),
        np.float32(sensor.full_well_electrons),
        np.float32(sensor.read_noise_electrons**2),
        np.float32(readout.gain * (top_code - readout.black_level) / sensor.full_well_electrons),
        np.float32(readout.black_level),
        np.float32(top_code),
        out.reshape(len(light), -1),
    )


def expected_codes(
    light: NDArray[np.float64], sensor: SensorModel, readout: Readout
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and standard deviation of the codes in float64, before quantisation and before the lower end of the converter cuts noise off.

    The oracle of `expose`, and where tolerances come from: a pixel's share of the linear range is (code - black) / (top - black).

    Args:
        light: radiance of photodiodes, any shape.
        sensor: the sensor.
        readout: its settings.

    Returns:
        (mean, deviation), codes, like `light`; the deviation is that of an unbounded sensor also where the well is full.
    """
    top_code = 2**readout.bits - 1
    electrons = light * (sensor.full_well_electrons * readout.exposure_s / sensor.full_well_radiance)
    scale = readout.gain * (top_code - readout.black_level) / sensor.full_well_electrons
    mean = np.minimum(
        np.minimum(electrons, sensor.full_well_electrons) * scale + readout.black_level, top_code
    )
    return mean, np.sqrt(electrons + sensor.read_noise_electrons**2) * scale
