"""Responses: closed forms, and what room files can get wrong."""

from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.errors import ConfigError
from nearfield_server.imaging.pixel_formats import FORMATS
from nearfield_server.imaging.response import Response, make_response, signal_of_codes
from nearfield_server.scene.device_schema import SensorTable

MONO12 = FORMATS["Mono12"]


def _make(name: str = "Mono12", **keys: object) -> Response:
    return make_response(SensorTable.model_validate(keys), FORMATS[name])


def test_linear_codes_run_from_the_black_level_to_the_top() -> None:
    response = _make(black_level=95, saturation=0.9)
    assert response.lookup[95] == 0
    assert response.lookup[4095] == 1
    assert response.lookup[95 + 1000] == np.float32(0.25)
    assert response.lookup[45] == np.float32(-50 / 4000)
    assert response.lookup[5000] == 1
    assert response.saturated_from == 3686
    assert response.step == pytest.approx(1 / 4000)


def test_a_companded_sensor_is_linear_again() -> None:
    # x -> sqrt(x), 16 bits of light in 12 bits, on a foot of 100 codes.
    points = np.linspace(0, 1, 400)
    table = {"kind": "table", "codes": list(100 + 3995 * points), "signal": list(points**2)}
    response = _make(response=table, black_level=100)
    light = np.linspace(0.01, 1, 77)
    codes = np.rint(100 + 3995 * np.sqrt(light)).astype(int)
    np.testing.assert_allclose(response.lookup[codes], light, rtol=3e-3)
    # Below the first point, noise goes on at the slope of the first piece.
    slope = points[1] ** 2 / (3995 * points[1])
    np.testing.assert_allclose(response.lookup[90], -10 * slope, rtol=1e-4)


def test_a_table_that_does_not_begin_at_zero_loses_its_black_level() -> None:
    table = {"kind": "table", "codes": [0, 255], "signal": [0.5, 2.5]}
    response = _make("Mono8", response=table, black_level=51)
    np.testing.assert_allclose(response.lookup[[51, 255]], [0, 1.6], rtol=1e-6)


def test_a_multi_slope_sensor_is_the_inverse_of_its_exposure() -> None:
    black, knees, top = 64.0, ((0.5, 8.0), (0.75, 64.0)), 4095.0
    light = np.linspace(0.0, 18.0, 301)  # in codes of the first slope over the linear range
    straight = black + light * (top - black)
    # The sensor: each slope begins where the one before reaches its knee.
    code = np.minimum(straight, 0.5 * top)
    code += np.clip((straight - 0.5 * top) / 8.0, 0, 0.25 * top)
    code += np.maximum(straight - 0.5 * top - 8 * 0.25 * top, 0) / 64.0
    table = SensorTable.model_validate({"response": {"kind": "knee", "knees": knees}, "black_level": black})
    keep = code <= top
    assert keep.sum() > 250
    np.testing.assert_allclose(signal_of_codes(code[keep], table, MONO12), light[keep], atol=1e-9)


def test_codes_for_displays_are_srgb_unless_a_table_says_otherwise() -> None:
    # sRGB 188 is half the light of white (IEC 61966-2-1), 118 is middle grey.
    np.testing.assert_allclose(_make("YUYV").lookup[[0, 118, 188, 255]], [0, 0.1812, 0.5029, 1], atol=1e-4)
    np.testing.assert_array_equal(_make("MJPG").lookup, _make("UYVY").lookup)
    assert _make("RGB8").lookup[51] == np.float32(0.2)
    straight = {"kind": "table", "codes": [0, 255], "signal": [0, 1]}
    assert _make("YUYV", response=straight).lookup[51] == np.float32(0.2)


def test_impossible_responses_are_refused() -> None:
    with pytest.raises(ConfigError, match="black_level = 4080, expected a code below 4014"):
        _make(black_level=4080)
    for codes in ([8000, 65535], [0, 65535], [4050, 4095]):
        with pytest.raises(ConfigError, match=f"codes of Mono12 .0 to 4095., found {codes[0]} to {codes[1]}"):
            _make(response={"kind": "table", "codes": codes, "signal": [0, 1]})
