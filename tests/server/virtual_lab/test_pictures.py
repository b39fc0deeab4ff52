from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nearfield_server.virtual_lab.pictures import (
    Codec,
    box_half,
    codec_error,
    read_exr,
    round_mantissa,
    write_exr,
)


@pytest.mark.parametrize("bits", [4, 6, 8, 10])
def test_mantissa_rounding_bound(bits: int) -> None:
    rng = np.random.default_rng(1)
    values = np.exp(rng.uniform(np.log(1e-4), np.log(6e4), 5000)).astype(np.float32)
    rounded = round_mantissa(values, bits).astype(np.float64)
    exact_half = values.astype(np.float16).astype(np.float64)
    assert np.all(np.abs(rounded - exact_half) <= exact_half * 2.0 ** -(bits + 1))
    codes = rounded.astype(np.float16).view(np.uint16)
    assert not np.any(codes & ((1 << (10 - bits)) - 1))


def test_rounding_keeps_zero_and_powers_of_two() -> None:
    values = np.array([0.0, 0.125, 1.0, 64.0, 32768.0])
    np.testing.assert_array_equal(round_mantissa(values, 5).astype(np.float64), values)


def test_lossless_round_trip(tmp_path: Path) -> None:
    picture = np.random.default_rng(2).random((20, 30, 3)).astype(np.float16)
    write_exr(tmp_path / "a.exr", picture, Codec())
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr"), picture)


def test_codec_error_reports_what_changed(tmp_path: Path) -> None:
    picture = np.full((16, 16, 3), 2.0, dtype=np.float32)
    picture[:, 12:] = 100.0
    emission = np.zeros((16, 16), dtype=np.float32)
    emission[:, 12:] = 1.0
    changed = picture.copy()
    changed[:, :12] += 0.5
    changed[:, 12:] *= 1.25
    write_exr(tmp_path / "a.exr", changed, Codec())
    report = codec_error(tmp_path / "a.exr", picture, emission)
    assert report["rms_rel"] == pytest.approx(0.25)
    assert report["p9995_rel"] == pytest.approx(0.25)
    assert report["emitter_flux_rel"] == pytest.approx(0.25)


def test_lossy_error_grows_with_the_level(tmp_path: Path) -> None:
    picture = np.random.default_rng(3).random((64, 64, 3)).astype(np.float32)
    errors = []
    for level in (5.0, 50.0, 500.0):
        write_exr(tmp_path / "a.exr", picture, Codec(dwaa_level=level))
        errors.append(
            codec_error(tmp_path / "a.exr", picture, np.zeros((64, 64), dtype=np.float32))["rms_rel"]
        )
    assert errors == sorted(errors)
    assert errors[0] < errors[-1]


def test_box_half_keeps_the_mean() -> None:
    picture = np.random.default_rng(4).random((2, 8, 6, 3))
    half = box_half(picture)
    assert half.shape == (2, 4, 3, 3)
    np.testing.assert_allclose(half.mean(axis=(1, 2)), picture.mean(axis=(1, 2)))
    np.testing.assert_allclose(half[0, 1, 2], picture[0, 2:4, 4:6].mean(axis=(0, 1)))
