"""The controls of a video node: found, read and set by number or by name, with refusals in words."""

from __future__ import annotations

import ctypes
import errno
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from nearfield_server.capture.v4l2 import kernel_api as api
from nearfield_server.capture.v4l2.video_node import VideoNode
from nearfield_server.errors import CaptureError

_MOST_CONTROLS = 1024
_NUMBERS = (
    api.ControlType.INTEGER,
    api.ControlType.BOOLEAN,
    api.ControlType.MENU,
    api.ControlType.INTEGER64,
    api.ControlType.BITMASK,
    api.ControlType.INTEGER_MENU,
)


@dataclass(frozen=True, slots=True)
class Control:
    """One control.

    Attributes:
        number: V4L2_CID_...
        name: in the spelling of v4l2-ctl: "Exposure Time, Absolute" is "exposure_time_absolute".
        kind: `ControlType`, or a larger number for compound ones.
        minimum: least value. maximum: greatest. step: between values. default: of the driver.
        flags: `ControlFlag`.
    """

    number: int
    name: str
    kind: int
    minimum: int
    maximum: int
    step: int
    default: int
    flags: int

    @property
    def holds_number(self) -> bool:
        """It has one value, a whole number."""
        return self.kind in _NUMBERS and not self.flags & api.ControlFlag.HAS_PAYLOAD

    @property
    def can_be_set(self) -> bool:
        """It takes values in principle; it may be inactive or grabbed for the time being."""
        return not self.flags & (api.ControlFlag.READ_ONLY | api.ControlFlag.DISABLED)

    def nearest(self, value: float) -> int:
        """Return the nearest value that the control can have."""
        step = max(1, self.step)
        steps = round((min(max(value, self.minimum), self.maximum) - self.minimum) / step)
        return self.minimum + min(steps, (self.maximum - self.minimum) // step) * step

    def __str__(self) -> str:
        return f"{self.name} ({self.minimum}..{self.maximum}, default {self.default})"


def spell(name: str) -> str:
    """Return the name of a control as v4l2-ctl spells it: letters and digits in lower case, anything else one underscore."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


class ControlSet:
    """All controls of an opened node, as they were when this was made.

    Args:
        node: the opened node.

    Raises:
        OSError: the device is gone.
    """

    def __init__(self, node: VideoNode) -> None:
        self._node = node
        self._by_number = {control.number: control for control in _list_controls(node)}

    def __iter__(self) -> Iterator[Control]:
        return iter(self._by_number.values())

    def find(self, number: int) -> Control | None:
        """Return a standard control, None if the device does not have it."""
        return self._by_number.get(number)

    def named(self, name: str) -> Control:
        """Return a control by its name.

        Raises:
            CaptureError: there is none; lists those that there are.
        """
        wanted = spell(name)
        for control in self:
            if control.name == wanted:
                return control
        listed = ", ".join(str(control) for control in self if control.holds_number and control.can_be_set)
        raise CaptureError(f"controls: no control '{name}'; the camera has: {listed or 'none'}")

    def refresh(self, control: Control) -> Control:
        """Ask for the limits anew: those of an exposure depend on format and frame rate."""
        question = api.QueryExtCtrl(id=control.number)
        self._node.call(api.Request.QUERY_EXT_CTRL, question)
        found = _control(question)
        self._by_number[found.number] = found
        return found

    def get(self, control: Control) -> int:
        """Read the value now.

        Raises:
            OSError: the device does not answer.
        """
        return _exchange(self._node, api.Request.G_EXT_CTRLS, control, 0)

    def set(self, control: Control, value: int) -> int:
        """Set a value and return what the control has then.

        Raises:
            CaptureError: out of its range, or refused; says what it takes.
            OSError: the device is gone.
        """
        if not control.can_be_set:
            raise CaptureError(
                f"control {control.name} is read-only on this camera; expected no value for it"
            )
        is_button = control.kind == api.ControlType.BUTTON
        if not (control.holds_number or is_button):
            raise CaptureError(
                f"control {control.name} does not hold a number; it cannot be set from a room file"
            )
        if not is_button and not control.minimum <= value <= control.maximum:
            raise CaptureError(
                f"control {control.name}: expected {control.minimum}..{control.maximum} "
                f"in steps of {max(1, control.step)}, found {value}{self._menu(control)}"
            )
        try:
            stored = _exchange(self._node, api.Request.S_EXT_CTRLS, control, value)
        except OSError as error:
            raise _refusal(error, control, value, self._menu(control)) from error
        unreadable = api.ControlFlag.WRITE_ONLY | api.ControlFlag.EXECUTE_ON_WRITE
        return stored if is_button or control.flags & unreadable else self.get(control)

    def _menu(self, control: Control) -> str:
        """The items of a menu in words, for messages."""
        if control.kind not in (api.ControlType.MENU, api.ControlType.INTEGER_MENU):
            return ""
        items = []
        for index in range(control.minimum, min(control.maximum, control.minimum + 64) + 1):
            question = api.QueryMenu(id=control.number, index=index)
            try:
                self._node.call(api.Request.QUERYMENU, question)
            except OSError:
                continue  # menus may have holes
            is_text = control.kind == api.ControlType.MENU
            items.append(f"{index} = {api.text(question.name) if is_text else question.value}")
        return f"; there are: {', '.join(items)}"

    def has_item(self, control: Control, index: int) -> bool:
        """Whether a menu has an item."""
        try:
            self._node.call(api.Request.QUERYMENU, api.QueryMenu(id=control.number, index=index))
        except OSError as error:
            if error.errno == errno.EINVAL:
                return False
            raise
        return True


def _refusal(error: OSError, control: Control, value: int, menu: str) -> Exception:
    if error.errno in (errno.EINVAL, errno.ERANGE):
        return CaptureError(f"control {control.name}: the camera refuses {value}{menu}")
    if error.errno == errno.EBUSY:
        return CaptureError(
            f"control {control.name}: the camera refuses {value} while something else uses it"
        )
    if error.errno in (errno.EACCES, errno.EPERM):
        return CaptureError(
            f"control {control.name}: the camera refuses {value} now; is it governed by an automatic that is on?"
        )
    if error.errno in (errno.EIO, errno.ETIMEDOUT, errno.EPIPE, errno.EPROTO):
        return CaptureError(f"control {control.name}: the camera did not take {value} ({error.strerror})")
    return error


def _control(answer: api.QueryExtCtrl) -> Control:
    return Control(
        number=answer.id,
        name=spell(api.text(answer.name)),
        kind=answer.type,
        minimum=answer.minimum,
        maximum=answer.maximum,
        step=answer.step,
        default=answer.default_value,
        flags=answer.flags,
    )


def _list_controls(node: VideoNode) -> Iterable[Control]:
    number = 0
    for _ in range(_MOST_CONTROLS):
        answer = api.QueryExtCtrl(id=number | api.ControlFlag.NEXT_CTRL)
        try:
            node.call(api.Request.QUERY_EXT_CTRL, answer)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return
            raise
        number = answer.id
        if answer.type != api.ControlType.CTRL_CLASS and not answer.flags & api.ControlFlag.DISABLED:
            yield _control(answer)


def _exchange(node: VideoNode, request: api.Request, control: Control, value: int) -> int:
    """Write or read one control; returns the value afterwards."""
    is_wide = control.kind == api.ControlType.INTEGER64
    entry = api.ExtControl(id=control.number)
    if is_wide:
        entry.value64 = value
    else:
        # Bit masks use all 32 bits.
        entry.value = ctypes.c_int32(value).value
    node.call(request, api.ExtControls(which=0, count=1, controls=ctypes.pointer(entry)))
    if is_wide:
        return int(entry.value64)
    return int(entry.value) & 0xFFFF_FFFF if control.kind == api.ControlType.BITMASK else int(entry.value)
