from __future__ import annotations

import errno

import pytest
from tests.server.capture.v4l2.scripted_kernel import ScriptedCamera, ScriptedControl

from nearfield_server.capture.v4l2.control_setup import (
    set_automatics_off,
    set_image_controls_to_default,
    set_named_controls,
)
from nearfield_server.capture.v4l2.controls import ControlSet, spell
from nearfield_server.capture.v4l2.kernel_api import ControlFlag, ControlId, ControlType
from nearfield_server.errors import CaptureError

FOCUS = 0x009A090A


def controls_of(*controls: ScriptedControl) -> tuple[ScriptedCamera, ControlSet]:
    camera = ScriptedCamera(controls=list(controls))
    return camera, ControlSet(camera.open("/dev/video0"))


def test_names_are_spelled_as_v4l2_ctl_does() -> None:
    assert spell("Exposure Time, Absolute") == "exposure_time_absolute"
    assert spell("White Balance, Auto & Preset") == "white_balance_auto_preset"
    assert spell("Focus (absolute)") == "focus_absolute"


def test_controls_are_found_by_number_and_by_any_spelling_of_their_name() -> None:
    _, controls = controls_of(ScriptedControl(FOCUS, "Focus, Absolute", default=7))
    assert controls.find(FOCUS) == controls.named("focus_absolute") == controls.named("Focus, Absolute")
    assert controls.find(ControlId.GAIN) is None
    with pytest.raises(CaptureError, match=r"no control 'zoom'.*focus_absolute \(0\.\.255, default 7\)"):
        controls.named("zoom")


def test_values_are_set_and_rounded_by_the_driver() -> None:
    camera, controls = controls_of(ScriptedControl(FOCUS, "Focus, Absolute", maximum=250, step=5))
    focus = controls.named("focus_absolute")
    assert controls.set(focus, 13) == 15
    assert controls.get(focus) == camera.control(FOCUS).value == 15
    assert [focus.nearest(value) for value in (-3, 12.4, 12.6, 999)] == [0, 10, 15, 250]


def test_a_value_out_of_range_names_the_range() -> None:
    _, controls = controls_of(ScriptedControl(FOCUS, "Focus, Absolute", maximum=250, step=5))
    with pytest.raises(CaptureError, match=r"focus_absolute: expected 0\.\.250 in steps of 5, found 300"):
        controls.set(controls.named("focus_absolute"), 300)


def test_a_menu_lists_its_items_holes_left_out() -> None:
    _, controls = controls_of(
        ScriptedControl(0x00980918, "Power Line Frequency", menu={0: "Disabled", 2: "60 Hz"})
    )
    menu = controls.named("power_line_frequency")
    assert controls.set(menu, 2) == 2
    with pytest.raises(CaptureError, match=r"refuses 1; there are: 0 = Disabled, 2 = 60 Hz"):
        controls.set(menu, 1)
    assert [controls.has_item(menu, index) for index in range(3)] == [True, False, True]


def test_wide_and_negative_numbers_survive() -> None:
    camera, controls = controls_of(
        ScriptedControl(
            ControlId.PIXEL_RATE, "Pixel Rate", maximum=10**10, default=5 * 10**9, kind=ControlType.INTEGER64
        ),
        ScriptedControl(ControlId.BRIGHTNESS, "Brightness", minimum=-64, maximum=64),
    )
    assert controls.get(controls.named("pixel_rate")) == 5_000_000_000
    assert controls.set(controls.named("brightness"), -64) == -64
    assert camera.control(ControlId.BRIGHTNESS).value == -64


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EBUSY, "while something else uses it"),
        (errno.EACCES, "governed by an automatic"),
        (errno.ERANGE, "the camera refuses 3"),
        (errno.EIO, "did not take 3"),
    ],
)
def test_refusals_are_explained(number: int, words: str) -> None:
    _, controls = controls_of(ScriptedControl(FOCUS, "Focus, Absolute", refusal=number))
    with pytest.raises(CaptureError, match=rf"focus_absolute: .*{words}"):
        controls.set(controls.named("focus_absolute"), 3)


def test_a_read_only_control_takes_nothing() -> None:
    _, controls = controls_of(ScriptedControl(FOCUS, "Focus, Absolute", flags=ControlFlag.READ_ONLY))
    with pytest.raises(CaptureError, match="read-only"):
        controls.set(controls.named("focus_absolute"), 3)


def worn_camera() -> ScriptedCamera:
    """A camera whose automatics are on and whose picture controls someone has changed."""
    return ScriptedCamera(
        controls=[
            ScriptedControl(ControlId.BRIGHTNESS, "Brightness", default=128, value=200),
            ScriptedControl(ControlId.AUTO_WHITE_BALANCE, "White Balance, Automatic", maximum=1, default=1),
            ScriptedControl(ControlId.AUTOGAIN, "Gain, Automatic", maximum=1, default=1),
            ScriptedControl(
                ControlId.EXPOSURE_AUTO,
                "Auto Exposure",
                menu={1: "Manual", 3: "Aperture Priority"},
                default=3,
            ),
            ScriptedControl(
                ControlId.EXPOSURE_AUTO_PRIORITY, "Exposure, Dynamic Framerate", maximum=1, value=1
            ),
            ScriptedControl(FOCUS, "Focus, Absolute", value=99),
        ]
    )


def test_automatics_are_switched_off_and_the_picture_is_reset_but_what_moves_is_left_alone() -> None:
    camera = worn_camera()
    controls = ControlSet(camera.open("/dev/video0"))
    assert set_automatics_off(controls, {}) == []
    assert set_image_controls_to_default(controls, {}) == []
    values = {control.number: control.value for control in camera.controls.values()}
    assert values == {
        ControlId.BRIGHTNESS: 128,
        ControlId.AUTO_WHITE_BALANCE: 0,
        ControlId.AUTOGAIN: 0,
        ControlId.EXPOSURE_AUTO: 1,
        ControlId.EXPOSURE_AUTO_PRIORITY: 0,
        FOCUS: 99,
    }


def test_what_the_room_file_names_is_left_to_the_room_file() -> None:
    camera = worn_camera()
    controls = ControlSet(camera.open("/dev/video0"))
    named = {"white_balance_automatic": True, "Brightness": 90}
    set_automatics_off(controls, named)
    set_image_controls_to_default(controls, named)
    assert ("White Balance, Automatic", 0) not in camera.written
    assert set_named_controls(controls, named) == []
    assert camera.written[-2:] == [("White Balance, Automatic", 1), ("Brightness", 90)]


def test_an_automatic_that_cannot_be_switched_off_is_told_in_words() -> None:
    camera = ScriptedCamera(
        controls=[
            ScriptedControl(ControlId.EXPOSURE_AUTO, "Auto Exposure", menu={0: "Auto"}),
            ScriptedControl(ControlId.AUTOGAIN, "Gain, Automatic", maximum=1, value=1, refusal=errno.EBUSY),
        ]
    )
    gain, exposure = set_automatics_off(ControlSet(camera.open("/dev/video0")), {})
    assert "gain_automatic" in gain
    assert "exposes by itself" in exposure


def test_shutter_priority_is_taken_where_there_is_no_manual_exposure() -> None:
    camera = ScriptedCamera(
        controls=[ScriptedControl(ControlId.EXPOSURE_AUTO, "Auto Exposure", menu={0: "Auto", 2: "Shutter"})]
    )
    assert set_automatics_off(ControlSet(camera.open("/dev/video0")), {}) == []
    assert camera.control(ControlId.EXPOSURE_AUTO).value == 2


def test_a_rounded_value_of_the_room_file_is_told() -> None:
    camera = ScriptedCamera(controls=[ScriptedControl(FOCUS, "Focus, Absolute", maximum=250, step=5)])
    warnings = set_named_controls(ControlSet(camera.open("/dev/video0")), {"focus_absolute": 12})
    assert warnings == ["control focus_absolute: asked for 12, the camera took 10"]
