"""Unpacking against payloads written bit by bit, and against colour equations in float64."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nearfield_server.errors import CaptureError
from nearfield_server.imaging.pixel_formats import FORMATS, Packing, PixelFormat, pixel_format
from nearfield_server.imaging.unpacking import unpack

from .payloads import payload

RAW = [name for name, layout in FORMATS.items() if not layout.is_video and layout.bayer is None]
"""Every layout once: those of mosaics are the same, see `test_a_mosaic_lies_in_memory_as_a_grey_picture`."""


def _codes(layout: PixelFormat, height: int, width: int, seed: int) -> np.ndarray:
    shape = (height, width, 3) if layout.channels == 3 else (height, width)
    return np.random.default_rng(seed).integers(0, layout.top_code, shape, np.uint16, endpoint=True)


@pytest.mark.parametrize("name", RAW)
@settings(max_examples=25)
@given(
    height=st.integers(1, 5),
    groups=st.integers(1, 9),
    padding=st.sampled_from([0, 0, 1, 3]),
    seed=st.integers(0, 2**32),
)
def test_codes_come_back_from_their_bits(
    name: str, height: int, groups: int, padding: int, seed: int
) -> None:
    layout = FORMATS[name]
    # Whole groups where the layout demands them; any width for streams, so that rows begin within a byte.
    width = groups * layout.group if layout.packing is Packing.MIPI else groups
    codes = _codes(layout, height, width, seed)
    data, row_bytes = payload(codes, layout, padding)
    np.testing.assert_array_equal(unpack(data, layout, width, height, row_bytes), codes)
    assert data.size - padding == layout.payload_bytes(width, height, row_bytes) or (
        layout.packing is Packing.GIGE_VISION and width % 2 == 1
    )


def test_a_mosaic_lies_in_memory_as_a_grey_picture() -> None:
    for pair, phase in {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}.items():
        for name in RAW:
            if name.startswith("Mono"):
                of_mosaic = FORMATS[name.replace("Mono", f"Bayer{pair}")]
            elif name.startswith("Y"):
                of_mosaic = FORMATS[name.replace("Y", f"S{phase}")]
            else:
                continue
            assert of_mosaic.bayer == phase
            assert replace(of_mosaic, name=name, bayer=None) == FORMATS[name]


@pytest.mark.parametrize("name", RAW)
def test_a_payload_that_is_a_byte_short_is_refused(name: str) -> None:
    layout = FORMATS[name]
    data, _ = payload(_codes(layout, 4, 8, 0), layout)
    with pytest.raises(CaptureError, match=f"takes {data.size} bytes, found {data.size - 1}"):
        unpack(data[:-1], layout, 8, 4)
    unpack(np.append(data, np.uint8(7)), layout, 8, 4)


def test_nonsense_is_refused_in_words() -> None:
    with pytest.raises(CaptureError, match='"Mono11": cannot be read'):
        pixel_format("Mono11")
    with pytest.raises(CaptureError, match="multiple of 4"):
        unpack(np.zeros(99, np.uint8), FORMATS["SRGGB10P"], 6, 2)
    with pytest.raises(CaptureError, match="row_bytes = 15"):
        unpack(np.zeros(99, np.uint8), FORMATS["Mono16"], 8, 2, row_bytes=15)
    with pytest.raises(CaptureError, match="expected bytes, found uint16"):
        unpack(np.zeros(64, np.uint16), FORMATS["Mono8"], 8, 8)


@pytest.mark.parametrize("name", ["YUYV", "UYVY", "YUV422_8", "YUV422_8_UYVY"])
def test_yuv_is_rgb_by_the_equations_of_bt601(name: str) -> None:
    layout = FORMATS[name]
    data = np.random.default_rng(3).integers(0, 256, (6, 4, 4), np.uint8)
    found = unpack(data.reshape(-1), layout, 8, 6)
    u_y = (1, 0) if layout.packing is Packing.UYVY else (0, 1)
    y = np.stack([data[..., u_y[0]], data[..., u_y[0] + 2]], -1).astype(float)
    u, v = (np.repeat(data[..., u_y[1] + k][..., None], 2, -1) - 128.0 for k in (0, 2))
    if layout.is_limited:
        y, u, v = (y - 16) * 255 / 219, u * 255 / 224, v * 255 / 224
    # Definition of Y, U, V from R, G, B, solved for them.
    kr, kb = 0.299, 0.114
    kg = 1 - kr - kb
    red, blue = y + 2 * (1 - kr) * v, y + 2 * (1 - kb) * u
    rgb = np.stack([red, (y - kr * red - kb * blue) / kg, blue], -1)
    expected = np.clip(rgb, 0, 255).reshape(6, 8, 3)
    assert np.abs(found - expected).max() <= 0.51


def test_white_and_black_of_video_are_the_ends_of_the_range() -> None:
    white, black = [235, 128], [16, 128]
    found = unpack(np.array(2 * white + 2 * black, np.uint8), FORMATS["YUYV"], 4, 1)
    np.testing.assert_array_equal(found[0], [[255] * 3] * 2 + [[0] * 3] * 2)


def _jpeg(picture: np.ndarray) -> np.ndarray:
    options = [
        cv2.IMWRITE_JPEG_QUALITY,
        100,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    ]
    return np.asarray(cv2.imencode(".jpg", picture[..., ::-1], options)[1]).reshape(-1)


def test_a_jpeg_is_red_green_blue_and_may_be_padded() -> None:
    rows, columns = np.mgrid[0:32, 0:48]
    picture = (
        np.stack([4 * rows, 4 * columns, 255 - 3 * rows - 3 * columns], -1).clip(0, 255).astype(np.uint8)
    )
    data = _jpeg(picture)
    for padded in (data, np.append(data, np.zeros(100, np.uint8))):
        found = unpack(padded, FORMATS["MJPG"], 48, 32)
        assert np.abs(found.astype(int) - picture).max() <= 4


def test_a_jpeg_of_a_webcam_without_huffman_tables_is_read() -> None:
    data = _jpeg(np.full((16, 16, 3), 90, np.uint8)).tobytes()
    at, bare = 2, data[:2]
    while data[at : at + 2] != b"\xff\xda":
        length = 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if data[at : at + 2] != b"\xff\xc4":
            bare += data[at : at + length]
        at += length
    bare += data[at:]
    assert len(bare) < len(data)
    found = unpack(np.frombuffer(bare, np.uint8), FORMATS["MJPG"], 16, 16)
    assert np.abs(found.astype(int) - 90).max() <= 1


def test_damaged_jpegs_are_refused() -> None:
    data = _jpeg(np.random.default_rng(0).integers(0, 256, (32, 32, 3), np.uint8))
    for broken in (data[: data.size // 2], data[2:], np.zeros(0, np.uint8), data[:1]):
        with pytest.raises(CaptureError, match="not a whole JPEG"):
            unpack(broken, FORMATS["MJPG"], 32, 32)
    with pytest.raises(CaptureError, match="expected a picture of 64 x 32 pixels, found 32 x 32"):
        unpack(data, FORMATS["MJPG"], 64, 32)
