from __future__ import annotations

import pytest
from pydantic import ValidationError
from tests.server.capture.v4l2.scripted_kernel import ScriptedCamera, ScriptedControl

from nearfield_server.capture.v4l2.controls import ControlSet
from nearfield_server.capture.v4l2.exposure_control import (
    LineTiming,
    find_exposure_scale,
    find_gain_scale,
    read_line_timing,
)
from nearfield_server.capture.v4l2.kernel_api import ControlId, ControlType
from nearfield_server.scene.device_schema import V4l2SourceTable


def controls_of(*controls: ScriptedControl) -> ControlSet:
    return ControlSet(ScriptedCamera(controls=list(controls)).open("/dev/video0"))


def test_absolute_exposure_counts_in_tenths_of_a_millisecond() -> None:
    controls = controls_of(
        ScriptedControl(ControlId.EXPOSURE_ABSOLUTE, "Exposure Time, Absolute", minimum=3, maximum=2047)
    )
    scale = find_exposure_scale(controls, None, None)
    assert scale is not None
    assert scale.range_s == pytest.approx((3e-4, 0.2047))
    assert [scale.value(time_s) for time_s in (0.01, 0.00996, 1e-9, 9.0)] == [100, 100, 3, 2047]
    assert scale.seconds(100) == pytest.approx(0.01)


def test_the_shortest_exposure_is_one_unit_and_never_none() -> None:
    controls = controls_of(ScriptedControl(ControlId.EXPOSURE_ABSOLUTE, "Exposure", minimum=0, maximum=100))
    scale = find_exposure_scale(controls, None, None)
    assert scale is not None
    assert scale.value(1e-9) == 1
    assert scale.range_s[0] == pytest.approx(1e-4)


def sensor(**extra: int) -> ControlSet:
    """A bare sensor: 840 million pixels per second, lines of 3280 + 168 pixels."""
    return controls_of(
        ScriptedControl(ControlId.EXPOSURE, "Exposure", minimum=4, maximum=1000, default=500),
        ScriptedControl(
            ControlId.PIXEL_RATE,
            "Pixel Rate",
            maximum=2**40,
            default=extra.get("rate", 840_000_000),
            kind=ControlType.INTEGER64,
        ),
        ScriptedControl(ControlId.HBLANK, "Horizontal Blanking", maximum=5000, default=168),
    )


def test_lines_become_seconds_by_pixel_rate_and_line_length() -> None:
    controls = sensor()
    timing = read_line_timing(controls, width=3280)
    assert timing is not None
    assert timing.line_s == pytest.approx(3448 / 840e6)
    scale = find_exposure_scale(controls, None, timing)
    assert scale is not None
    assert scale.seconds(250) == pytest.approx(250 * 3448 / 840e6)
    assert scale.value(1e-3) == round(1e-3 * 840e6 / 3448)


def test_blanking_lines_give_the_frame_rate() -> None:
    timing = LineTiming(pixel_rate=840_000_000, line_pixels=3448)
    lines = timing.blank_lines(height=2464, frame_rate=30.0)
    assert 840e6 / (3448 * (2464 + lines)) == pytest.approx(30.0)


def test_a_unit_that_nobody_tells_is_not_guessed() -> None:
    assert read_line_timing(sensor(rate=0), 640) is None
    controls = controls_of(ScriptedControl(ControlId.EXPOSURE, "Exposure", maximum=1000))
    assert find_exposure_scale(controls, None, None) is None
    told = find_exposure_scale(controls, 2e-5, None)
    assert told is not None
    assert told.value(0.001) == 50
    assert find_exposure_scale(controls_of(), None, None) is None


def test_gain_steps_say_what_gain_values_mean() -> None:
    # As sensors with 0.3 dB a step do it.
    steps = ((0, 0.0), (240, 72.0))
    scale = find_gain_scale(controls_of(ScriptedControl(ControlId.GAIN, "Gain", maximum=100)), steps)
    assert scale is not None
    assert scale.range == pytest.approx((1.0, 10 ** (30 / 20)))
    assert scale.value(10.0) == 67  # 20 dB = 66.7 steps
    assert scale.gain(67) == pytest.approx(10 ** (67 * 0.3 / 20))
    assert [scale.value(gain) for gain in (0.01, 1.0, 1e9)] == [0, 0, 100]


def test_the_analogue_gain_goes_before_the_mixed_one() -> None:
    controls = controls_of(
        ScriptedControl(ControlId.GAIN, "Gain"), ScriptedControl(ControlId.ANALOGUE_GAIN, "Analogue Gain")
    )
    scale = find_gain_scale(controls, ((0, 0.0), (255, 48.0)))
    assert scale is not None
    assert scale.control.name == "analogue_gain"
    assert find_gain_scale(controls, ()) is None


@pytest.mark.parametrize("steps", [[[0, 0.0]], [[0, 0.0], [0, 6.0]], [[0, 6.0], [10, 3.0]]])
def test_gain_steps_ascend(steps: list[list[float]]) -> None:
    with pytest.raises(ValidationError, match="gain_steps"):
        V4l2SourceTable(kind="v4l2", path="/dev/video0", gain_steps=steps)  # type: ignore[arg-type]
