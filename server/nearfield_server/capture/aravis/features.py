"""Settings of a camera (GenICam features): types, ranges and errors in words; every number that it tells is checked before it is used."""

from __future__ import annotations

import ctypes
import difflib
import math
from collections.abc import Callable, Collection
from typing import Final, TypeVar

from nearfield_server.capture.aravis.library import (
    ACCESS_READ_ONLY,
    ACCESS_WRITE_ONLY,
    Aravis,
    AravisError,
    printable,
)
from nearfield_server.errors import CaptureError

FeatureValue = bool | int | float | str
_Result = TypeVar("_Result")
_KINDS: Final = (  # the first that fits: enumerations are integers too
    ("ArvGcCommand", "command"),
    ("ArvGcBoolean", "boolean"),
    ("ArvGcEnumeration", "enumeration"),
    ("ArvGcFloat", "float"),
    ("ArvGcInteger", "integer"),
    ("ArvGcString", "string"),
)


class Features:
    """The features of one opened device.

    Args:
        aravis: the library.
        device: the ArvDevice; owned by the caller.
        where: names the camera in messages.
        names: of all nodes of its description, to suggest what was meant.
    """

    def __init__(self, aravis: Aravis, device: int, where: str, names: Collection[str] = ()) -> None:
        self._aravis, self._c, self._device = aravis, aravis.c, device
        self._where, self._names = where, names

    def kind(self, name: str) -> str | None:
        """Type of a feature: "command", "boolean", "enumeration", "float", "integer", "string"; None if there is none of that name."""
        node = self._c.arv_device_get_feature(self._device, name.encode())
        if node is None:
            return None
        return next((kind for gtype, kind in _KINDS if self._aravis.is_a(node, gtype)), None)

    def has(self, name: str) -> bool:
        """Whether the camera has the feature now; some come and go with other settings.

        Raises:
            AravisError: the camera does not answer.
        """
        if self.kind(name) is None:
            return False
        try:
            return self._c.arv_device_is_feature_available(self._device, name.encode())
        except AravisError as error:
            if error.is_timeout:
                raise
            return False

    def first(self, *names: str) -> str | None:
        """The first feature of these that the camera has."""
        return next((name for name in names if self.has(name)), None)

    def is_writable(self, name: str) -> bool:
        """Whether the camera has the feature and lets it be set."""
        return (
            self.has(name)
            and self._c.arv_device_get_feature_access_mode(self._device, name.encode()) != ACCESS_READ_ONLY
        )

    def number(self, name: str) -> float:
        """Value of a float, integer or boolean feature.

        Raises:
            CaptureError: no such feature, or its value is no finite number.
        """
        match self._require(name, "float", "integer", "boolean", "enumeration"):
            case "float":
                value = self._checked(name, self._c.arv_device_get_float_feature_value)
                if not math.isfinite(value):
                    raise CaptureError(f"{self._where}: expected a finite number as {name}, found {value}")
                return value
            case "boolean":
                return float(self._checked(name, self._c.arv_device_get_boolean_feature_value))
            case _:
                return self._checked(name, self._c.arv_device_get_integer_feature_value)

    def text(self, name: str) -> str:
        """Value of a string or enumeration feature, printable."""
        self._require(name, "string", "enumeration")
        return printable(self._checked(name, self._c.arv_device_get_string_feature_value))

    def value(self, name: str) -> FeatureValue | None:
        """Value of any feature as the room file has it; None for commands and what cannot be read."""
        kind = self.kind(name)
        if (
            kind in (None, "command")
            or self._c.arv_device_get_feature_access_mode(self._device, name.encode()) == ACCESS_WRITE_ONLY
        ):
            return None
        if kind in ("string", "enumeration"):
            return self.text(name)
        number = self.number(name)
        return bool(number) if kind == "boolean" else int(number) if kind == "integer" else number

    def range(self, name: str) -> tuple[float, float]:
        """Least and greatest value of a float or integer feature now (they follow other settings); infinite where there is no limit.

        Raises:
            CaptureError: the camera names a range that is none.
        """
        if self._require(name, "float", "integer") == "float":
            low, high = ctypes.c_double(math.nan), ctypes.c_double(math.nan)
            self._bounds(name, self._c.arv_device_get_float_feature_bounds, low, high)
            least, greatest = low.value, high.value
        else:
            low_int, high_int = ctypes.c_int64(0), ctypes.c_int64(-1)
            self._bounds(name, self._c.arv_device_get_integer_feature_bounds, low_int, high_int)
            least, greatest = low_int.value, high_int.value
        if not least <= greatest:  # also false for NaN
            raise CaptureError(
                f"{self._where}: expected a range of {name}, found {least} to {greatest}; its description is broken"
            )
        return least, greatest

    def step(self, name: str) -> int:
        """What values of an integer feature must be apart from its least one, at least 1."""
        self._require(name, "integer")
        return max(1, self._checked(name, self._c.arv_device_get_integer_feature_increment))

    def entries(self, name: str) -> tuple[str, ...]:
        """Values that an enumeration can take now."""
        self._require(name, "enumeration")
        function = self._c.arv_device_dup_available_enumeration_feature_values_as_strings
        return self._checked(
            name,
            lambda device, feature: self._aravis.texts(lambda count: function(device, feature, count)),
        )

    def execute(self, name: str) -> None:
        """Execute a command."""
        self._require(name, "command")
        self._checked(name, self._c.arv_device_execute_command)

    def set(self, name: str, value: FeatureValue) -> None:
        """Set a feature of any type; a command is executed by `True`.

        Raises:
            CaptureError: there is no such feature, it cannot be set, or not to this value; says what it would take.
        """
        kind = self._require(name)
        if not self.is_writable(name):
            raise CaptureError(
                f"{self._where}: feature {name} cannot be set to {_quoted(value)} (it is read-only, or another setting locks it)"
            )
        match kind:
            case "command" if value is True:
                self.execute(name)
            case "boolean" if isinstance(value, bool) or value in (0, 1):
                self._write(name, value, self._c.arv_device_set_boolean_feature_value, bool(value))
            case "enumeration" if isinstance(value, str):
                self._set_entry(name, value)
            case "float" if isinstance(value, int | float) and not isinstance(value, bool):
                self._check_range(name, value)
                self._write(name, value, self._c.arv_device_set_float_feature_value, float(value))
            case "integer" if isinstance(value, int | float) and _is_whole(value):
                self._check_range(name, value)
                self._check_step(name, int(value))
                self._write(name, value, self._c.arv_device_set_integer_feature_value, int(value))
            case "string" if isinstance(value, str):
                self._write(name, value, self._c.arv_device_set_string_feature_value, value.encode())
            case _:
                raise CaptureError(
                    f"{self._where}: feature {name} is of type {kind}, it cannot be {_quoted(value)}; {self._expected(name, kind)}"
                )

    def set_if_possible(self, name: str, value: FeatureValue) -> bool:
        """Set a feature where the camera has it, lets it be set and knows the value; false otherwise.

        Raises:
            AravisError: the camera does not answer.
        """
        try:
            if not self.is_writable(name):
                return False
            if isinstance(value, str) and value not in self.entries(name):
                return False
            self.set(name, value)
        except AravisError as error:
            if error.is_timeout:
                raise
            return False
        except CaptureError:
            return False
        return True

    def set_clamped(self, name: str, value: float) -> float:
        """Set a float or integer feature as near to a value as its range and step allow; returns what the camera made of it."""
        least, greatest = self.range(name)
        value = min(max(value, least), greatest)
        if self.kind(name) == "integer":
            step = self.step(name)
            value = least + (round(value) - least) // step * step
            self._write(name, value, self._c.arv_device_set_integer_feature_value, int(value))
        else:
            self._write(name, value, self._c.arv_device_set_float_feature_value, value)
        return self.number(name)

    def _require(self, name: str, *kinds: str) -> str:
        kind = self.kind(name)
        if kind is None:
            near = difflib.get_close_matches(name, self._names, 3, 0.7)
            hint = f"; did you mean {' or '.join(printable(other, 64) for other in near)}?" if near else ""
            raise CaptureError(f"{self._where} has no feature {printable(name, 64)}{hint}")
        if kinds and kind not in kinds:
            raise CaptureError(
                f"{self._where}: expected feature {name} to be {' or '.join(kinds)}, found {kind}"
            )
        return kind

    def _set_entry(self, name: str, value: str) -> None:
        entries = self.entries(name)
        if value not in entries:
            raise CaptureError(
                f"{self._where}: feature {name} cannot be {_quoted(value)}; expected one of {', '.join(entries)}"
            )
        self._write(name, value, self._c.arv_device_set_string_feature_value, value.encode())

    def _check_range(self, name: str, value: float) -> None:
        least, greatest = self.range(name)
        if not least <= value <= greatest:
            raise CaptureError(
                f"{self._where}: feature {name} cannot be {value}; expected {_number(least)} to {_number(greatest)}"
            )

    def _check_step(self, name: str, value: int) -> None:
        least, step = int(self.range(name)[0]), self.step(name)
        if (value - least) % step:
            below = value - (value - least) % step
            raise CaptureError(
                f"{self._where}: feature {name} cannot be {value}; it goes in steps of {step}: {below} or {below + step}"
            )

    def _expected(self, name: str, kind: str) -> str:
        match kind:
            case "enumeration":
                return f"expected one of {', '.join(self.entries(name))}"
            case "float" | "integer":
                least, greatest = self.range(name)
                return f"expected a number from {_number(least)} to {_number(greatest)}"
            case "string":
                return "expected a text"
            case _:
                return "expected true" if kind == "command" else "expected true or false"

    def _bounds(
        self,
        name: str,
        function: Callable[..., None],
        low: ctypes.c_double | ctypes.c_int64,
        high: ctypes.c_double | ctypes.c_int64,
    ) -> None:
        self._checked(
            name,
            lambda device, feature: function(device, feature, ctypes.byref(low), ctypes.byref(high)),
        )

    def _write(self, name: str, value: FeatureValue, function: Callable[..., None], argument: object) -> None:
        try:
            function(self._device, name.encode(), argument)
        except AravisError as error:
            raise self._failed(f"feature {name} = {_quoted(value)}", error) from error

    def _checked(self, name: str, function: Callable[[int, bytes], _Result]) -> _Result:
        try:
            return function(self._device, name.encode())
        except AravisError as error:
            raise self._failed(f"feature {name}", error) from error

    def _failed(self, what: str, error: AravisError) -> AravisError:
        reason = "the camera does not answer" if error.is_timeout else error.reason
        return AravisError(f"{self._where}: {what}", error.domain, error.code, reason)


def _is_whole(value: int | float) -> bool:
    if isinstance(value, bool):
        return False
    return isinstance(value, int) or value.is_integer()


def _quoted(value: FeatureValue) -> str:
    return (
        f'"{printable(value)}"'
        if isinstance(value, str)
        else str(value).lower()
        if isinstance(value, bool)
        else str(value)
    )


def _number(value: float) -> str:
    return f"{value:.9g}"
