"""The fast path against the definitions in float64: every phase, single exposures and brackets."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.errors import CaptureError, ConfigError
from nearfield_server.imaging import development
from nearfield_server.imaging.development import BOUND_ALPHA, Developer, compile_kernels
from nearfield_server.imaging.pixel_formats import FORMATS
from nearfield_server.reference.imaging import demosaicked, merged_samples
from nearfield_server.scene.device_schema import SensorTable

from .payloads import payload

MATRIX = ((1.7, -0.5, -0.2), (-0.3, 1.6, -0.3), (0.0, -0.6, 1.9))


def _blank(height: int, width: int) -> np.ndarray:
    return np.full((height, width, 4), np.nan, np.float16)


def _offset(developer: Developer) -> float:
    return float(developer._offset)


def _uses(bound: np.ndarray, bayer: str) -> np.ndarray:
    """Pixels that use a marked sample: themselves, greens their four neighbours, the others all eight."""
    padded = np.pad(bound, 1, mode="reflect")
    height, width = bound.shape
    near = {
        (r, c): padded[1 + r : 1 + r + height, 1 + c : 1 + c + width] for r in (-1, 0, 1) for c in (-1, 0, 1)
    }
    cross = near[0, 0] | near[0, 1] | near[0, -1] | near[1, 0] | near[-1, 0]
    square = np.any(list(near.values()), axis=0)
    green = np.tile(
        np.array([[name == "G" for name in bayer[:2]], [name == "G" for name in bayer[2:]]]),
        (height // 2, width // 2),
    )
    return np.where(green, cross, square)


@pytest.mark.parametrize("pair", ["RG", "GR", "GB", "BG"])
@given(
    half_height=st.integers(2, 6),
    half_width=st.integers(2, 20),
    num_exposures=st.integers(1, 3),
    seed=st.integers(0, 2**32),
)
def test_a_mosaic_is_developed_by_the_definition(
    pair: str, half_height: int, half_width: int, num_exposures: int, seed: int
) -> None:
    height, width = 2 * half_height, 2 * half_width
    rng = np.random.default_rng(seed)
    layout = FORMATS[f"Bayer{pair}12p"]
    table = SensorTable(black_level=100.0, color_matrix=MATRIX, radiance_per_code=3.0)
    developer = Developer(table, layout.name, width, height)
    amounts = np.array([0.02, 0.002, 0.0005])[:num_exposures]
    codes = rng.integers(60, 4096, (num_exposures, height, width), np.uint16)
    codes[rng.random(codes.shape) < 0.7] //= 8
    packed = [payload(each, layout)[0] for each in codes]
    out = _blank(height, width)
    if num_exposures == 1:
        developer.develop(packed[0], 0, amounts[0], out)
    else:
        for position in reversed(range(num_exposures)):
            developer.keep(position, packed[position], 0)
        developer.merge(amounts, out)

    signals = list((codes - 100.0) / 3995.0)
    samples, bound = merged_samples(signals, list(codes >= 4014), amounts / amounts.max())
    assert layout.bayer is not None
    rgb = demosaicked(samples, layout.bayer, _offset(developer))
    radiance = np.clip(rgb @ np.array(MATRIX).T * 3.0 / amounts.max(), 0, 65504)
    marked = _uses(bound, layout.bayer) | (radiance > 65504).any(-1)
    np.testing.assert_array_equal(out[..., 3], np.where(marked, BOUND_ALPHA, 1))
    assert developer.saturated == marked.sum()
    size = np.abs(rgb).max(-1, keepdims=True) * 3.0 / amounts.max()
    # Half floats round by 2^-11; the differences of the matrix and single precision add a little of the largest channel.
    assert np.all(np.abs(out[..., :3] - radiance) <= 2**-11 * radiance + 3e-4 * size + 1e-6)


@pytest.mark.parametrize("name", ["Mono8", "Mono12p", "Mono16", "RGB8", "BGR8"])
def test_pictures_without_a_mosaic_are_scaled_pixel_by_pixel(name: str) -> None:
    layout = FORMATS[name]
    shape = (5, 7, 3) if layout.channels == 3 else (5, 7)
    codes = np.random.default_rng(2).integers(0, layout.top_code, shape, np.uint16, endpoint=True)
    table = SensorTable(radiance_per_code=2.0, color_matrix=MATRIX, saturation=0.9)
    developer = Developer(table, name, 7, 5)
    out = developer.develop(payload(codes, layout)[0], 0, 0.5, _blank(5, 7))
    rgb = np.repeat(codes[..., None], 3, -1) if layout.channels == 1 else codes
    matrix = np.eye(3) if layout.channels == 1 else np.array(MATRIX)
    radiance = np.maximum(rgb / layout.top_code @ matrix.T * 4.0, 0)
    np.testing.assert_allclose(out[..., :3], radiance, rtol=6e-4, atol=2e-6)
    bound = (rgb >= np.ceil(0.9 * layout.top_code)).any(-1)
    np.testing.assert_array_equal(out[..., 3] < 1, bound)
    assert developer.saturated == bound.sum()


def test_nothing_above_the_half_range_leaves_and_it_is_marked() -> None:
    developer = Developer(SensorTable(radiance_per_code=1e6), "Mono8", 4, 1)
    out = developer.develop(np.array([0, 10, 100, 200], np.uint8), 0, 1.0, _blank(1, 4))
    np.testing.assert_array_equal(out[0, :, 0], np.array([0, 39215.686, 65504, 65504], np.float16))
    np.testing.assert_array_equal(out[0, :, 3] < 1, [False, False, True, True])


def test_a_grey_field_stays_grey_and_exact_at_all_borders() -> None:
    for pair in ("RG", "GR", "GB", "BG"):
        developer = Developer(SensorTable(), f"Bayer{pair}12", 12, 8)
        data = np.full(96, 1000, "<u2").view(np.uint8)
        out = developer.develop(data, 0, 1.0, _blank(8, 12))
        np.testing.assert_allclose(out[..., :3], 1000 / 4095, rtol=5e-4)


def test_a_lamp_in_a_dark_room_leaves_no_ring() -> None:
    # A lamp of ten thousand times the room, edges at all angles: outside the lamp's own edge nothing may go dark or bright.
    rows, columns = np.mgrid[0:96, 0:96]
    distance = np.hypot(rows - 47.3, columns - 48.2)
    picture = np.where(distance < 20, 10_000.0, 1.0)
    response_range = 16383
    for pair in ("RG", "GB"):
        developer = Developer(SensorTable(radiance_per_code=response_range), f"Bayer{pair}14", 96, 96)
        data = np.rint(picture).astype("<u2").view(np.uint8).reshape(-1)
        out = developer.develop(data, 0, 1.0, _blank(96, 96))[..., :3].astype(float)
        outside, inside = distance > 23, distance < 17
        np.testing.assert_allclose(out[outside], 1.0, rtol=0.02)
        np.testing.assert_allclose(out[inside], 10_000.0, rtol=1e-3)
        assert abs(out.mean() / picture.mean() - 1) < 0.01


def test_sizes_that_are_no_mosaic_are_refused() -> None:
    for width, height in ((7, 8), (8, 7), (2, 8)):
        with pytest.raises(ConfigError, match="even width and height"):
            Developer(SensorTable(), "BayerRG8", width, height)


def test_wrong_pictures_are_refused() -> None:
    developer = Developer(SensorTable(), "Mono8", 8, 4)
    with pytest.raises(CaptureError, match="takes 32 bytes, found 31"):
        developer.develop(np.zeros(31, np.uint8), 0, 1.0, _blank(4, 8))
    with pytest.raises(CaptureError, match="takes 32 bytes, found 31"):
        developer.keep(0, np.zeros(31, np.uint8), 0)
    with pytest.raises(CaptureError, match="developed picture"):
        developer.develop(np.zeros(32, np.uint8), 0, 1.0, _blank(8, 4))
    with pytest.raises(CaptureError, match="seconds times gain"):
        developer.develop(np.zeros(32, np.uint8), 0, 0.0, _blank(4, 8))
    developer.keep(0, np.zeros(32, np.uint8), 0)
    with pytest.raises(CaptureError, match="2 exposures expected, 1 were kept"):
        developer.merge([1.0, 0.1], _blank(4, 8))


def test_once_prepared_no_picture_waits_for_the_compiler() -> None:
    compile_kernels()
    kernels = [each for each in vars(development).values() if hasattr(each, "signatures")]
    assert len(kernels) > 5
    before = {each.__name__: len(each.signatures) for each in kernels}
    read_only = np.frombuffer(bytes(96), np.uint8)
    assert not read_only.flags.writeable
    for name, data in (
        ("BayerGB12p", read_only),
        ("RGB8", read_only),
        ("YUYV", np.zeros(192, np.uint8)[::2]),
    ):
        width, height = (8, 4) if name == "RGB8" else (8, 6)
        developer = Developer(SensorTable(), name, width, height)
        out = _blank(height, width)
        developer.develop(data, 0, 0.01, out)
        for position in range(3):
            developer.keep(position, data, 0)
        developer.ratios(3)
        developer.merge([1.0, 0.1, 0.01], out)
    assert {each.__name__: len(each.signatures) for each in kernels} == before
