"""Puts a camera into a known state: automatics off, picture controls at their defaults, then what the room file says.

Cameras keep their controls while they have power, so whatever a program did to them before would show in the light.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from nearfield_server.capture.v4l2.controls import Control, ControlSet, spell
from nearfield_server.capture.v4l2.kernel_api import ControlId, ExposureAuto
from nearfield_server.errors import CaptureError

_OFF = {
    ControlId.AUTO_WHITE_BALANCE: 0,
    ControlId.AUTO_N_PRESET_WHITE_BALANCE: 0,
    ControlId.AUTOGAIN: 0,
    ControlId.EXPOSURE_AUTO_PRIORITY: 0,  # it lets a camera lower its frame rate
    ControlId.ISO_SENSITIVITY_AUTO: 0,
    ControlId.AUTOBRIGHTNESS: 0,
    ControlId.HUE_AUTO: 0,
    ControlId.WIDE_DYNAMIC_RANGE: 0,
}
_TO_DEFAULT = (
    ControlId.BRIGHTNESS,
    ControlId.CONTRAST,
    ControlId.SATURATION,
    ControlId.HUE,
    ControlId.WHITE_BALANCE_TEMPERATURE,
    ControlId.RED_BALANCE,
    ControlId.BLUE_BALANCE,
    ControlId.GAMMA,
    ControlId.SHARPNESS,
    ControlId.BACKLIGHT_COMPENSATION,
    ControlId.COLORFX,
    ControlId.HFLIP,
    ControlId.VFLIP,
)


def _left_to_us(
    controls: ControlSet, numbers: Iterable[ControlId], named: Mapping[str, int | bool]
) -> Iterator[Control]:
    """Standard controls that the camera has, that can be set, and that the room file does not name."""
    names = {spell(name) for name in named}
    for number in numbers:
        control = controls.find(number)
        if control is not None and control.can_be_set and control.name not in names:
            yield control


def _try(controls: ControlSet, control: Control, value: int, meaning: str) -> list[str]:
    """Set a control; a refusal becomes a warning in words."""
    try:
        found = controls.set(control, value)
    except CaptureError as error:
        return [f"{meaning}: {error}"]
    return [] if found == value else [f"{meaning}: control {control.name} stays at {found}; expected {value}"]


def set_automatics_off(controls: ControlSet, named: Mapping[str, int | bool]) -> list[str]:
    """Switch off what changes the picture by itself; returns warnings in words.

    Args:
        controls: of the camera.
        named: `controls` of the room file, which are left alone.

    Raises:
        OSError: the device is gone.
    """
    warnings = []
    for control in _left_to_us(controls, _OFF, named):
        warnings += _try(
            controls, control, _OFF[ControlId(control.number)], "an automatic cannot be switched off"
        )
    for control in _left_to_us(controls, [ControlId.EXPOSURE_AUTO], named):
        # Some cameras only have "shutter priority": the exposure time by hand, the iris by itself.
        items = [ExposureAuto.MANUAL, ExposureAuto.SHUTTER_PRIORITY]
        manual = next((item for item in items if controls.has_item(control, item)), None)
        if manual is None:
            warnings.append(
                f"the camera exposes by itself and control {control.name} cannot switch that off: its light is not measured"
            )
        else:
            warnings += _try(controls, control, manual, "automatic exposure cannot be switched off")
    return warnings


def set_image_controls_to_default(controls: ControlSet, named: Mapping[str, int | bool]) -> list[str]:
    """Put the controls that shape the picture to the driver's defaults; returns warnings in words.

    Raises:
        OSError: the device is gone.
    """
    warnings = []
    for control in _left_to_us(controls, _TO_DEFAULT, named):
        warnings += _try(controls, control, control.default, "a picture control cannot be reset")
    return warnings


def set_named_controls(controls: ControlSet, named: Mapping[str, int | bool]) -> list[str]:
    """Set the controls of the room file in its order; returns warnings about values that the camera changed.

    Raises:
        CaptureError: no such control, or the camera refuses a value.
        OSError: the device is gone.
    """
    warnings = []
    for name, wish in named.items():
        control = controls.named(name)
        found = controls.set(control, int(wish))
        if found != int(wish):
            warnings.append(f"control {control.name}: asked for {int(wish)}, the camera took {found}")
    return warnings
