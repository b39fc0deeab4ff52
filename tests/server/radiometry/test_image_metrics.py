"""Definitions of the picture errors, by pictures whose errors are known."""

from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.radiometry import image_metrics


@pytest.fixture
def pictures():
    rng = np.random.default_rng(1)
    truth = rng.uniform(0.5, 1.5, (8, 10, 3))
    coverage = np.zeros((8, 10))
    coverage[:4] = 1.0
    coverage[4] = 0.5
    return truth, coverage, np.zeros((8, 10), np.bool_)


def test_average_keeps_the_mean_and_each_block():
    picture = np.arange(24.0).reshape(4, 6)
    half = image_metrics.average_2x2(picture)
    assert half.shape == (2, 3)
    assert half[0, 0] == (0 + 1 + 6 + 7) / 4
    assert half.mean() == picture.mean()
    with pytest.raises(ValueError, match="even"):
        image_metrics.average_2x2(np.zeros((3, 4)))


def test_object_error_of_a_scaled_picture_is_the_scale(pictures):
    truth, coverage, _ = pictures
    flat = np.full_like(truth, 2.0)
    assert image_metrics.object_rel_rmse(1.1 * flat, flat, coverage) == pytest.approx(0.1)
    assert image_metrics.object_rel_rmse(truth, truth, coverage) == 0.0


def test_object_error_looks_at_covered_pixels_alone(pictures):
    truth, coverage, _ = pictures
    spoilt = truth.copy()
    spoilt[coverage <= 0.999] = 100.0
    assert image_metrics.object_rel_rmse(spoilt, truth, coverage) == 0.0
    assert image_metrics.object_rel_rmse(truth, truth, np.zeros_like(coverage)) is None


def test_no_shadow_drawn_is_one_and_a_perfect_shadow_is_zero(pictures):
    truth, coverage, emitter = pictures
    change = -0.1 * truth
    assert image_metrics.shadow_rel_rmse(np.zeros_like(truth), change, coverage, emitter) == 1.0
    assert image_metrics.shadow_rel_rmse(change, change, coverage, emitter) == 0.0
    assert image_metrics.shadow_rel_rmse(2.0 * change, change, coverage, emitter) == pytest.approx(1.0)
    assert image_metrics.shadow_rel_rmse(change, np.zeros_like(truth), coverage, emitter) is None


def test_shadow_error_leaves_out_emitters_and_objects(pictures):
    truth, coverage, emitter = pictures
    change = -0.1 * truth
    found = change.copy()
    found[:5] = 7.0
    emitter[6, 2] = True
    found[6, 2] = 9.0
    assert image_metrics.shadow_rel_rmse(found, change, coverage, emitter) == 0.0


def test_exposure_brings_the_98th_percentile_to_nine_tenths():
    grey = np.linspace(0.0, 5.0, 101)[:, None, None] * np.ones((1, 1, 3))
    assert image_metrics.common_exposure([grey]) == pytest.approx(0.9 / 4.9)
    assert image_metrics.common_exposure([np.zeros((2, 2, 3))]) == 1.0
    assert image_metrics.common_exposure([]) == 1.0


def test_display_is_srgb_with_clipping():
    shown = image_metrics.display(np.array([[[0.0, 0.5, 2.0], [-1.0, 0.0031308 / 2, 1.0]]]), 1.0)
    np.testing.assert_allclose(shown, [[[0.0, 0.735357, 1.0], [0.0, 0.020225, 1.0]]], atol=1e-5)


def test_flip_and_ssim_of_equal_and_of_different_pictures():
    rng = np.random.default_rng(2)
    picture = rng.random((48, 64, 3)).astype(np.float32)
    worse = np.clip(picture + 0.05, 0, 1).astype(np.float32)
    worst = 1 - picture
    assert image_metrics.flip_mean(picture, picture) == 0.0
    assert image_metrics.ssim(picture, picture) == pytest.approx(1.0)
    assert 0.0 < image_metrics.flip_mean(picture, worse) < image_metrics.flip_mean(picture, worst) <= 1.0
    assert image_metrics.ssim(picture, worst) < image_metrics.ssim(picture, worse) < 1.0


def test_flip_of_black_against_white_is_nearly_one():
    # Andersson et al. 2020: the largest colour difference maps to 1.
    black = np.zeros((32, 32, 3), np.float32)
    assert image_metrics.flip_mean(black, black + 1.0) == pytest.approx(1.0, abs=0.05)
