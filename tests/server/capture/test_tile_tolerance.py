"""What is kept is never further away than the tolerance, however slowly the picture drifts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nearfield_server.capture.ingest import ingest_frame

TOLERANCE = 0.02


def _halves(pixels: np.ndarray) -> np.ndarray:
    target = np.empty((*pixels.shape[:2], 4), np.float16)
    ingest_frame(pixels, target)
    return target


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-4, 1e-3, 0.02, 0.2]), st.sampled_from([1e-6, 1.0, 1e4]))
@settings(deadline=None, max_examples=25)
def test_the_error_stays_within_the_bound_over_a_random_walk(seed: int, step: float, scale: float) -> None:
    """At any moment every value in use lies within tolerance times itself of the measured one; drift does not add up."""
    rng = np.random.default_rng(seed)
    truth = (scale * rng.random((40, 70, 3))).astype(np.float32)
    in_use = _halves(truth)
    kept = 0
    for _ in range(60):
        truth *= np.float32(1.0) + rng.uniform(-step, step, truth.shape[:2]).astype(np.float32)[..., None]
        target, changed = np.empty_like(in_use), np.empty((2, 3), bool)
        ingest_frame(truth, target, previous=in_use, changed=changed, tolerance=TOLERANCE)
        measured, used = _halves(truth).astype(np.float64), target.astype(np.float64)
        assert (np.abs(measured - used) <= TOLERANCE * used).all()
        unchanged = ~np.kron(changed, np.ones((32, 32), bool))[:40, :70]
        np.testing.assert_array_equal(target[unchanged], in_use[unchanged])
        np.testing.assert_array_equal(target[~unchanged], _halves(truth)[~unchanged])
        kept += int((~changed).sum())
        in_use = target
    assert step > TOLERANCE or scale < 1.0 or kept > 0


def test_steady_drift_is_passed_on_as_often_as_the_tolerance_asks() -> None:
    """One per mille per frame leaves a band of two per cent every twenty frames or so, never later."""
    in_use = _halves(np.ones((32, 32, 3), np.float32))
    updates = 0
    for frame in range(1, 201):
        target, changed = np.empty_like(in_use), np.empty((1, 1), bool)
        pixels = np.full((32, 32, 3), 1.001**frame, np.float32)
        ingest_frame(pixels, target, previous=in_use, changed=changed, tolerance=TOLERANCE)
        updates += int(changed[0, 0])
        in_use = target
    assert 8 <= updates <= 10


@pytest.mark.parametrize("change", ["dark", "light", "valid", "invalid"])
def test_light_from_nothing_and_validity_are_always_changes(change: str) -> None:
    pixels = np.ones((32, 32, 3), np.float32)
    other = pixels.copy()
    if change in ("light", "valid"):
        pixels, other = other, pixels
    (pixels if change in ("light", "valid") else other)[5, 6] = 0.0 if change in ("dark", "light") else np.nan
    changed = np.zeros((1, 1), bool)
    target = np.empty((32, 32, 4), np.float16)
    ingest_frame(other, target, previous=_halves(pixels), changed=changed, tolerance=0.1)
    assert changed[0, 0]
    np.testing.assert_array_equal(target, _halves(other))
