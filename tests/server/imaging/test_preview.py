"""Pictures for people: averages that leave out what is no measurement, brightness that follows the picture, marks that do not hide."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from nearfield_server.imaging.preview import (
    BOUND_MARK,
    GROUND,
    INVALID_MARK,
    encode_jpeg,
    middle_exposure,
    paint_preview,
    preview_size,
    reduce_picture,
    srgb_codes,
    tone_map,
)

LOWER_BOUND = np.uint16(0x3BFF).view(np.float16)


def _picture(seed: int = 1, height: int = 64, width: int = 96) -> np.ndarray:
    pixels = np.ones((height, width, 4), np.float16)
    pixels[..., :3] = np.random.default_rng(seed).uniform(0.1, 4.0, (height, width, 3))
    return pixels


def test_sizes_keep_the_shape_and_never_grow() -> None:
    assert preview_size(1024, 2048, 512) == (256, 512)
    assert preview_size(30, 40, 512) == (30, 40)
    assert preview_size(3, 4096, 256) == (1, 256)


def test_blocks_are_means_of_their_valid_pixels() -> None:
    pixels = _picture()
    invalid = np.random.default_rng(2).random((64, 96)) < 0.3
    pixels[invalid] = (7.0, 7.0, 7.0, 0.0)
    small = reduce_picture(pixels, 12)
    blocks = pixels.astype(np.float64).reshape(8, 8, 12, 8, 4).transpose(0, 2, 1, 3, 4).reshape(8, 12, 64, 4)
    weight = (blocks[..., 3] > 0.5).astype(np.float64)
    mean = (blocks[..., :3] * weight[..., None]).sum(2) / weight.sum(2)[..., None]
    np.testing.assert_allclose(small.radiance, mean, rtol=1e-5)
    np.testing.assert_allclose(small.valid, weight.mean(2), atol=1e-6)


def test_one_marked_pixel_among_a_million_is_seen() -> None:
    pixels = np.ones((1000, 1000, 4), np.float16)
    pixels[503, 207, 3] = LOWER_BOUND
    pixels[808, 911] = 0.0
    painted = paint_preview(pixels, max_side=100)
    assert np.argwhere((painted == BOUND_MARK).all(-1)).tolist() == [[50, 20]]
    assert np.argwhere((painted == INVALID_MARK).all(-1)).tolist() == [[80, 91]]
    unmarked = paint_preview(pixels, max_side=100, marks=False)
    assert not (unmarked == BOUND_MARK).all(-1).any()


def test_outside_the_image_circle_nothing_is_missing() -> None:
    pixels = np.ones((40, 40, 4), np.float16)
    circle = np.hypot(*(np.mgrid[0:40, 0:40] - 19.5)) < 15
    pixels[~circle] = 0.0
    painted = paint_preview(pixels, circle=circle)
    assert (painted[~circle] == GROUND).all()
    assert len(np.unique(painted[circle], axis=0)) == 1
    assert (paint_preview(pixels)[~circle] == INVALID_MARK).all()


@pytest.mark.parametrize("scale", [1e-4, 1e3])
def test_brightness_follows_the_picture(scale: float) -> None:
    pixels = _picture().astype(np.float32)
    scaled = pixels * np.array([scale, scale, scale, 1], np.float32)
    difference = paint_preview(pixels).astype(int) - paint_preview(scaled)
    assert np.abs(difference).max() <= 1
    assert middle_exposure(reduce_picture(scaled, 96)) * scale == pytest.approx(
        middle_exposure(reduce_picture(pixels, 96)), rel=1e-5
    )


def test_a_grey_picture_comes_out_at_the_middle_and_a_black_one_black() -> None:
    grey = np.ones((16, 16, 4), np.float16)
    grey[..., :3] = 3.7
    linear = 1.0 - np.exp(-0.18)
    code = round(255 * (1.055 * linear ** (1 / 2.4) - 0.055))
    np.testing.assert_array_equal(paint_preview(grey), code)
    # One stop: twice the exponent.
    brighter = round(255 * (1.055 * (1.0 - np.exp(-0.36)) ** (1 / 2.4) - 0.055))
    np.testing.assert_array_equal(paint_preview(grey, stops=1.0), brighter)
    grey[..., :3] = 0.0
    np.testing.assert_array_equal(paint_preview(grey), 0)


def test_tones_rise_from_black_to_white() -> None:
    radiance = np.concatenate([[0.0], np.geomspace(1e-4, 65504.0, 400)]).astype(np.float32)
    codes = tone_map(np.repeat(radiance[None, :, None], 3, axis=2), 0.5)[0, :, 0].astype(int)
    assert codes[0] == 0
    assert codes[-1] == 255
    assert (np.diff(codes) >= 0).all()
    # Codes of the sRGB standard for its own fixed points.
    np.testing.assert_array_equal(
        srgb_codes(np.array([-1.0, 0.0, 0.0031308, 0.21404114, 1.0, 9.0])), [0, 0, 10, 128, 255, 255]
    )


def test_the_file_is_a_jpeg_with_red_first() -> None:
    picture = np.zeros((32, 48, 3), np.uint8)
    picture[...] = (200, 100, 30)
    data = encode_jpeg(picture)
    assert data[:3] == b"\xff\xd8\xff"
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(decoded[..., ::-1].astype(int) - picture).max() <= 3
