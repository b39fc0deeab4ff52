import numpy as np
from numba import njit

from nearfield_server.radiometry.half import float_bits, float_to_half, half_to_float


@njit
def _to_float(bits: np.ndarray) -> np.ndarray:
    out = np.empty(bits.size, dtype=np.float32)
    for k in range(bits.size):
        out[k] = half_to_float(bits[k])
    return out


@njit
def _to_half(values: np.ndarray) -> np.ndarray:
    out = np.empty(values.size, dtype=np.uint16)
    for k in range(values.size):
        out[k] = float_to_half(values[k])
    return out


@njit
def _bits(values: np.ndarray) -> np.ndarray:
    out = np.empty(values.size, dtype=np.uint32)
    for k in range(values.size):
        out[k] = float_bits(values[k])
    return out


def test_every_half_converts_as_numpy_does() -> None:
    bits = np.arange(1 << 16, dtype=np.uint16)
    np.testing.assert_array_equal(_to_float(bits), bits.view(np.float16).astype(np.float32))


def test_floats_round_to_the_nearest_half_as_numpy_does() -> None:
    rng = np.random.default_rng(1)
    values = (10.0 ** rng.uniform(-8.0, 4.8, 20000)).astype(np.float32)
    values = np.append(values, np.array([0.0, 65504.0, 65519.0, 2049.0, 2051.0], dtype=np.float32))
    np.testing.assert_array_equal(_to_half(values), values.astype(np.float16).view(np.uint16))


def test_bits_sort_like_non_negative_values() -> None:
    values = np.sort(np.random.default_rng(2).exponential(size=1000).astype(np.float32))
    np.testing.assert_array_equal(_bits(values), values.view(np.uint32))
    assert (np.diff(_bits(values).astype(np.int64)) >= 0).all()
