from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.virtual_lab.backend import Backend
from nearfield_server.virtual_lab.sampling import Sampler

pytestmark = pytest.mark.lab


def pairs(backend: Backend, count: int, *, lanes: int = 4, dimension: int = 0, seed: int = 1) -> np.ndarray:
    """(lanes, count, 2)."""
    mi, dr = backend.mi, backend.dr
    sampler = Sampler(backend, dr.arange(mi.UInt32, lanes), seed)
    return np.stack(
        [np.stack([c.numpy() for c in sampler.pair(i, dimension)], axis=1) for i in range(count)], axis=1
    )


@pytest.mark.parametrize("dimension", [0, 5])
def test_every_elementary_interval_holds_one_sample(backend: Backend, dimension: int) -> None:
    count = 64
    points = pairs(backend, count, dimension=dimension)
    for log_columns in range(7):
        columns, rows = 2**log_columns, 2 ** (6 - log_columns)
        cell = np.floor(points[..., 0] * columns) * rows + np.floor(points[..., 1] * rows)
        for lane in cell:
            np.testing.assert_array_equal(np.sort(lane), np.arange(count))


def test_samples_depend_on_lane_dimension_and_seed_only(backend: Backend) -> None:
    reference = pairs(backend, 8)
    np.testing.assert_array_equal(pairs(backend, 8), reference)
    np.testing.assert_array_equal(pairs(backend, 8, lanes=2), reference[:2])
    assert not np.array_equal(pairs(backend, 8, seed=2), reference)
    assert not np.array_equal(pairs(backend, 8, dimension=1), reference)
    assert len({tuple(lane.ravel()) for lane in reference}) == len(reference)


def test_lanes_are_uniform_and_dimensions_uncorrelated(backend: Backend) -> None:
    lanes = 4096
    first, second = (pairs(backend, 1, lanes=lanes, dimension=d)[:, 0] for d in (0, 1))
    values = np.hstack([first, second])
    tolerance = 5 / np.sqrt(12 * lanes)
    np.testing.assert_allclose(values.mean(axis=0), 0.5, atol=tolerance)
    correlation = np.corrcoef(values.T) - np.eye(4)
    assert np.abs(correlation).max() < 5 / np.sqrt(lanes)
