"""A simulated sensor: what a real camera would have measured of a noise-free radiance picture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtri

from nearfield_server.errors import ConfigError

_BINS: Final = 65536


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorModel:
    """A linear sensor with photon noise, read noise, a full well and an analogue-digital converter.

    Attributes:
        full_well_radiance: radiance at which a pixel is full, W/(sr m^2); stands for the exposure.
        full_well_electrons: electrons of a full pixel; its square root is the best signal-to-noise ratio.
        read_noise_electrons: standard deviation of the read-out, electrons.
        bits: of the converter.
        seed: of the noise; frame n of one seed is always the same.
    """

    full_well_radiance: float
    full_well_electrons: float = 10_000.0
    read_noise_electrons: float = 3.0
    bits: int = 12
    seed: int = 1

    def __post_init__(self) -> None:
        if not (
            self.full_well_radiance > 0 and self.full_well_electrons > 0 and self.read_noise_electrons >= 0
        ):
            raise ConfigError(f"sensor: full well must be above 0 and read noise at least 0, found {self}")
        if not 8 <= self.bits <= 16:
            raise ConfigError(f"sensor: bits = {self.bits}, expected 8 to 16")


@cache
def _normal_table() -> NDArray[np.float32]:
    """(65536,) float32 of variance 1: the middles of as many bins of equal probability of a normal variable."""
    middle = ndtri((np.arange(_BINS) + 0.5) / _BINS)
    return np.asarray(middle / np.sqrt(np.mean(middle**2)), np.float32)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _mix_bits(value: Any) -> Any:
    """The finaliser of splitmix64: 64 bits that look independent for neighbouring numbers."""
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _expose(
    radiance: Any,
    measured: Any,
    key: Any,
    table: Any,
    electrons_per_radiance: Any,
    most_electrons: Any,
    read_variance: Any,
    codes_per_electron: Any,
    top_code: Any,
    radiance_per_code: Any,
) -> int:
    """(P, 3) radiance to (P, 3) measured radiance, float32; number of pixels with a saturated channel."""
    saturated = 0
    for pixel in range(radiance.shape[0]):
        bits = _mix_bits(key + np.uint64(pixel) * np.uint64(0x9E3779B97F4A7C15))
        is_full = False
        for channel in range(3):
            normal = table[(bits >> np.uint64(16 * channel)) & np.uint64(_BINS - 1)]
            expected = min(radiance[pixel, channel] * electrons_per_radiance, most_electrons)
            electrons = expected + np.sqrt(expected + read_variance) * normal
            code = np.rint(electrons * codes_per_electron)
            is_full |= code >= top_code
            measured[pixel, channel] = min(max(code, np.float32(0.0)), top_code) * radiance_per_code
        saturated += is_full
    return saturated


def simulate_sensor(
    radiance: NDArray[np.float32], sensor: SensorModel, frame_index: int
) -> tuple[NDArray[np.float32], int]:
    """Expose, add noise, saturate, quantise, and convert back to linear radiance.

    Negative values that read noise leaves are clipped at 0 by the converter, as real sensors with a black level of 0 do.

    Args:
        radiance: (H, W, 3) float32, finite and >= 0.
        sensor: the sensor.
        frame_index: selects the noise; the same index gives the same noise.

    Returns:
        (radiance (H, W, 3) float32 as measured, number of pixels with a saturated channel). A saturated channel holds `full_well_radiance`,
        a lower bound of what was there.
    """
    top_code = np.float32(2**sensor.bits - 1)
    plain = np.ascontiguousarray(radiance, np.float32)
    measured = np.empty_like(plain)
    seed = np.random.SeedSequence([sensor.seed, frame_index]).generate_state(1, np.uint64)[0]
    # A normal variable of the same variance stands for the Poisson one: the same above some twenty electrons.
    saturated = _expose(
        plain.reshape(-1, 3),
        measured.reshape(-1, 3),
        seed,
        _normal_table(),
        np.float32(sensor.full_well_electrons / sensor.full_well_radiance),
        np.float32(4.0 * sensor.full_well_electrons),
        np.float32(sensor.read_noise_electrons**2),
        top_code / np.float32(sensor.full_well_electrons),
        top_code,
        np.float32(sensor.full_well_radiance / float(top_code)),
    )
    return measured, saturated
