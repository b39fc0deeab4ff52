"""Laws of ingest: whatever comes in, what goes out is finite, in half range, and what was wrong is counted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from nearfield_server.capture.ingest import HALF_MAX, INGEST_COUNTERS, ingest_frame
from nearfield_server.errors import CaptureError

LOWER_BOUND = np.nextafter(np.float16(1), np.float16(0))


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
    bound = declared & ~nan & (pixels[..., 3] < 1 if pixels.shape[2] == 4 else False)
    np.testing.assert_array_equal(target[..., 3] == 1, declared & ~nan & ~bound)
    np.testing.assert_array_equal(target[..., 3] == LOWER_BOUND, bound)
    assert (target[target[..., 3] == 0] == 0).all()
    expected = np.clip(rgb, 0, HALF_MAX).astype(np.float32).astype(np.float16)
    valid = target[..., 3] > 0
    np.testing.assert_array_equal(target[valid][:, :3], expected[valid])
    assert counts == {
        "nan": nan.sum(),
        "infinite": np.isinf(rgb).any(-1).sum(),
        "negative": ((rgb < 0) & np.isfinite(rgb)).any(-1).sum(),
        "above_range": ((rgb > HALF_MAX) & np.isfinite(rgb)).any(-1).sum(),
        "lower_bound": bound.sum(),
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


def _tile_differs(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    rows, columns = -(-first.shape[0] // 32), -(-first.shape[1] // 32)
    differs = np.zeros((rows, columns), bool)
    for row, column in np.argwhere((first.view(np.uint16) != second.view(np.uint16)).any(-1)):
        differs[row // 32, column // 32] = True
    return differs


@given(
    st.integers(1, 70), st.integers(1, 70), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-3, 0.3, 1.0])
)
@settings(deadline=None, max_examples=60)
def test_exactly_the_tiles_that_differ_bit_for_bit_are_marked(
    height: int, width: int, seed: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    first = rng.random((height, width, 3), np.float32)
    second = np.where(rng.random((height, width, 1)) < share, np.nextafter(first, 2), first)
    second[rng.random((height, width)) < share / 4] = np.nan
    before, _ = _ingest(first)
    after = np.full_like(before, np.nan)
    changed = rng.random((-(-height // 32), -(-width // 32))) < 0.5  # whatever was there before
    ingest_frame(second, after, previous=before, changed=changed)
    np.testing.assert_array_equal(changed, _tile_differs(before, after))
    alone, _ = _ingest(second)
    np.testing.assert_array_equal(after.view(np.uint16), alone.view(np.uint16))


def test_without_a_picture_before_every_tile_is_marked() -> None:
    target, changed = np.zeros((40, 40, 4), np.float16), np.zeros((2, 2), bool)
    ingest_frame(np.zeros((40, 40, 3), np.float32), target, changed=changed)
    assert changed.all()


def test_the_sign_of_zero_is_no_change() -> None:
    before, _ = _ingest(np.zeros((2, 2, 3), np.float32))
    changed = np.ones((1, 1), bool)
    ingest_frame(
        np.full((2, 2, 3), -0.0, np.float32), np.empty_like(before), previous=before, changed=changed
    )
    assert not changed.any()
    negative = np.full((2, 2, 4), -0.0, np.float32)
    negative[..., 3], negative[0, 0, 1] = 1.0, -3.0
    ingest_frame(negative, np.empty_like(before), previous=before, changed=changed)
    assert not changed.any()


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_every_layout_of_a_source_gives_the_same_picture(channels: int, dtype: type) -> None:
    rng = np.random.default_rng(1)
    pixels = np.ones((33, 35, channels), dtype)
    pixels[..., :3] = rng.random((33, 35, 3)).astype(np.float16)
    target, _ = _ingest(pixels[::-1, ::-1])  # not contiguous
    np.testing.assert_array_equal(target[..., :3], pixels[::-1, ::-1, :3])
    assert (target[..., 3] == 1).all()


@given(
    hnp.arrays(np.uint16, (4, 6, 4), elements=st.integers(0, 0xFFFF)),
    hnp.arrays(np.uint16, (4, 6), elements=st.sampled_from([0x3C00, 0x3BFF, 0x3800, 0, 0x7C00, 0x7E00])),
    st.booleans(),
)
def test_half_words_are_cleaned_as_the_same_numbers_in_float(
    bits: np.ndarray, alpha: np.ndarray, any_alpha: bool
) -> None:
    if not any_alpha:
        bits[..., 3] = alpha
    halves = bits.view(np.float16)
    found, counts = _ingest(halves)
    expected, expected_counts = _ingest(halves.astype(np.float32))
    assert np.array_equal(found.view(np.uint16), expected.view(np.uint16))
    assert counts == expected_counts


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_lower_bounds_stay_marked_and_only_inside_the_circle_counted(dtype: type) -> None:
    pixels = np.full((40, 40, 4), 2.0, dtype)
    pixels[..., 3] = 1.0
    pixels[3, 5:9, 3], pixels[4, 5:9, 3], pixels[5, 5:9, 3] = 0.75, LOWER_BOUND, 0.5
    circle = np.ones((40, 40), bool)
    circle[3, 8] = False
    target, counts = _ingest(pixels, circle)
    assert counts == {**dict.fromkeys(INGEST_COUNTERS, 0), "lower_bound": 7}
    np.testing.assert_array_equal(target[3, 4:10, 3], np.array([1, *[LOWER_BOUND] * 3, 0, 1], np.float16))
    np.testing.assert_array_equal(target[4, 5:9], np.array([[2, 2, 2, LOWER_BOUND]] * 4, np.float16))
    assert not target[5, 5:9].any()


def test_a_pixel_that_becomes_a_lower_bound_is_a_change() -> None:
    pixels = np.ones((64, 64, 4), np.float16)
    before, _ = _ingest(pixels)
    pixels[40, 50, 3] = LOWER_BOUND
    changed = np.zeros((2, 2), bool)
    for tolerance in (0.0, 0.5):
        ingest_frame(pixels, np.empty_like(before), previous=before, changed=changed, tolerance=tolerance)
        np.testing.assert_array_equal(changed, [[False, False], [False, True]])
