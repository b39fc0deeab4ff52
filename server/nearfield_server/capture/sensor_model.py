"""A simulated sensor: what a real camera would have measured of a noise-free radiance picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import ConfigError


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
    noise = np.random.Generator(np.random.Philox(key=[sensor.seed, frame_index]))
    electrons_per_radiance = np.float32(sensor.full_well_electrons / sensor.full_well_radiance)
    expected = np.minimum(radiance * electrons_per_radiance, np.float32(4.0 * sensor.full_well_electrons))
    # A normal variable of the same variance stands for the Poisson one: ten times faster, and the same above some twenty electrons.
    deviation = np.sqrt(expected + np.float32(sensor.read_noise_electrons**2))
    electrons = expected + deviation * noise.standard_normal(expected.shape, dtype=np.float32)
    top_code = np.float32(2**sensor.bits - 1)
    codes = np.rint(electrons * (top_code / np.float32(sensor.full_well_electrons)))
    saturated = int(np.count_nonzero((codes >= top_code).any(axis=-1)))
    np.clip(codes, 0.0, top_code, out=codes)
    return codes * np.float32(sensor.full_well_radiance / float(top_code)), saturated
