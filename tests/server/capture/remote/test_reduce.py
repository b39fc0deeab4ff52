"""Means over blocks against plain numpy in float64."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from nearfield_server.capture.remote.reduce import reduce_picture


def oracle(pixels: NDArray[np.float64], factor: int) -> NDArray[np.float64]:
    height, width, _ = pixels.shape
    blocks = pixels.reshape(height // factor, factor, width // factor, factor, 4).swapaxes(1, 2)
    blocks = blocks.reshape(height // factor, width // factor, factor * factor, 4)
    counted = (blocks[..., 3] > 0.5) & ~np.isnan(blocks[..., :3]).any(axis=-1)
    number = counted.sum(axis=-1)
    total = np.where(counted[..., None], blocks[..., :3], 0.0).sum(axis=2)
    valid = 2 * number >= factor * factor
    means = np.where(valid[..., None], total / np.maximum(number, 1)[..., None], 0.0)
    bound = (counted & (blocks[..., 3] < 1.0)).any(axis=-1)
    return np.concatenate([means, np.where(valid, np.where(bound, 0.75, 1.0), 0.0)[..., None]], axis=-1)


@given(st.integers(0, 2**32), st.sampled_from([1, 2, 4]), st.integers(1, 4), st.integers(1, 4))
def test_blocks_become_the_means_of_their_measurements(
    seed: int, factor: int, rows: int, columns: int
) -> None:
    rng = np.random.default_rng(seed)
    pixels = rng.exponential(10.0, (rows * factor, columns * factor, 4)) - 1.0
    pixels[..., 3] = rng.choice([0.0, 0.5, 0.75, 1.0, np.nan], pixels.shape[:2])
    pixels[rng.random(pixels.shape[:2]) < 0.1, 1] = np.nan
    raw = pixels.astype(np.float32)
    out = np.empty((rows, columns, 4), np.float32)
    reduce_picture(raw, factor, out)
    np.testing.assert_allclose(out, oracle(raw.astype(np.float64), factor), rtol=1e-6, atol=1e-6)


def test_energy_is_kept_and_three_channels_are_all_valid() -> None:
    raw = np.random.default_rng(1).exponential(1.0, (8, 12, 3)).astype(np.float32)
    out = np.empty((2, 3, 4), np.float32)
    reduce_picture(raw, 4, out)
    np.testing.assert_allclose(
        out[..., :3].mean(axis=(0, 1)), raw.astype(np.float64).mean(axis=(0, 1)), rtol=1e-6
    )
    assert (out[..., 3] == 1.0).all()
    with pytest.raises(ValueError, match="blocks of 3 x 3"):
        reduce_picture(raw, 3, out)
