"""Laws of ingest: whatever comes in, what goes out is finite, in half range, and what was wrong is counted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from nearfield_server.capture.ingest import HALF_MAX, INGEST_COUNTERS, ingest_frame
from nearfield_server.errors import CaptureError


def _ingest(pixels: np.ndarray, circle: np.ndarray | None = None) -> tuple[np.ndarray, dict[str, int]]:
    target = np.full((*pixels.shape[:2], 4), np.nan, np.float16)
    return target, ingest_frame(pixels, target, circle)


@given(
    hnp.arrays(
        np.float32,
        st.tuples(st.integers(1, 4), st.integers(1, 4), st.sampled_from([3, 4])),
        elements=st.floats(width=32, allow_nan=True, allow_infinity=True),
    )
)
@settings(deadline=None)
def test_any_input_comes_out_clean_and_counted(pixels: np.ndarray) -> None:
    target, counts = _ingest(pixels)
    rgb = pixels[..., :3].astype(np.float64)
    nan = np.isnan(rgb).any(-1)
    declared = pixels[..., 3] > 0.5 if pixels.shape[2] == 4 else np.ones(pixels.shape[:2], bool)
    assert np.isfinite(target).all()
    assert (target >= 0).all()
    np.testing.assert_array_equal(target[..., 3] == 1, declared & ~nan)
    assert (target[target[..., 3] == 0] == 0).all()
    expected = np.clip(rgb, 0, HALF_MAX).astype(np.float32).astype(np.float16)
    valid = target[..., 3] == 1
    np.testing.assert_array_equal(target[valid][:, :3], expected[valid])
    assert counts == {
        "nan": nan.sum(),
        "infinite": np.isinf(rgb).any(-1).sum(),
        "negative": ((rgb < 0) & np.isfinite(rgb)).any(-1).sum(),
        "above_range": ((rgb > HALF_MAX) & np.isfinite(rgb)).any(-1).sum(),
    }


@given(hnp.arrays(np.float16, (3, 4, 3), elements=st.floats(0, HALF_MAX, width=16)))
@settings(deadline=None)
def test_clean_half_pictures_pass_bit_for_bit(pixels: np.ndarray) -> None:
    target, counts = _ingest(pixels)
    np.testing.assert_array_equal(target[..., :3], pixels)
    assert (target[..., 3] == 1).all()
    assert counts == dict.fromkeys(INGEST_COUNTERS, 0)


def test_outside_the_image_circle_everything_is_invalid_and_uncounted() -> None:
    pixels = np.full((2, 2, 3), np.nan, np.float32)
    pixels[0, 0] = 2.0
    circle = np.array([[True, False], [False, False]])
    target, counts = _ingest(pixels, circle)
    np.testing.assert_array_equal(target[0, 0], [2, 2, 2, 1])
    assert not target[~circle].any()
    assert counts == dict.fromkeys(INGEST_COUNTERS, 0)


@pytest.mark.parametrize(
    "pixels",
    [
        np.zeros((2, 2), np.float32),
        np.zeros((3, 2, 3), np.float32),
        np.zeros((2, 2, 2), np.float32),
        np.zeros((2, 2, 3)),
    ],
)
def test_wrong_shapes_and_types_are_refused(pixels: np.ndarray) -> None:
    with pytest.raises(CaptureError, match="frame of"):
        ingest_frame(pixels, np.zeros((2, 2, 4), np.float16))
    with pytest.raises(CaptureError, match="image circle"):
        ingest_frame(np.zeros((2, 2, 3), np.float32), np.zeros((2, 2, 4), np.float16), np.ones((3, 3), bool))
