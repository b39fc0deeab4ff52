"""What can be done to a simulated camera while it runs: commands as JSON objects, parsed and checked."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

from nearfield_server.errors import ConfigError
from nearfield_server.virtual_camera.formats import sent_format
from nearfield_server.virtual_camera.genicam import FLOAT_FEATURES

Picture = Literal["live", "frozen", "black", "saturated"]
_PICTURES: Final = ("live", "frozen", "black", "saturated")


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraState:
    """How a simulated camera behaves; replaced as a whole by each command.

    Attributes:
        lights: weight per light of the room.
        picture: "live", "frozen" (the same bytes again under new frame numbers), "black" (lid on), or "saturated" (blinded).
        loss: share of packets that are not sent, 0 to 1.
        clock_ppm: how much too fast the device's clock runs.
        clock_offset_ns: added to the device's clock.
        skip_frames: frame numbers left out, in all: pictures that the camera itself lost.
    """

    lights: tuple[float, ...]
    picture: Picture = "live"
    loss: float = 0.0
    clock_ppm: float = 0.0
    clock_offset_ns: int = 0
    skip_frames: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """One request.

    Attributes:
        state: fields of `CameraState` to replace.
        floats: features written behind the controlling client's back, such as {"ExposureTime": 20000.0}.
        pixel_format: name of a format to switch to in the running stream; None = as it is.
    """

    state: Mapping[str, Any] = field(default_factory=dict)
    floats: Mapping[str, float] = field(default_factory=dict)
    pixel_format: str | None = None

    def apply(self, state: CameraState) -> CameraState:
        """Return the state after the request."""
        return replace(state, **self.state)


def parse_command(line: str, num_lights: int) -> Command:
    """Parse one line: a JSON object with fields of `CameraState`, names of float features, or "pixel_format".

    Raises:
        ConfigError: no such command, or an impossible value.
    """
    try:
        request = json.loads(line)
    except ValueError as error:
        raise ConfigError(f"command {line.strip()!r}: not JSON ({error})") from error
    if not isinstance(request, dict):
        raise ConfigError(f"command {line.strip()!r}: expected a JSON object")
    state: dict[str, Any] = {}
    floats: dict[str, float] = {}
    pixel_format = None
    for name, value in request.items():
        try:
            if name in _STATE_FIELDS:
                state[name] = _STATE_FIELDS[name](value)
            elif name in FLOAT_FEATURES:
                floats[name] = float(value)
            elif name == "pixel_format":
                pixel_format = sent_format(str(value)).name
            else:
                known = ", ".join((*_STATE_FIELDS, *FLOAT_FEATURES, "pixel_format"))
                raise ConfigError(f"command {name!r}: there are {known}")
        except (TypeError, ValueError) as error:
            raise ConfigError(f"command {name!r}: {value!r} is impossible ({error})") from error
    if "lights" in state and len(state["lights"]) != num_lights:
        raise ConfigError(f"command 'lights': {len(state['lights'])} weights for {num_lights} lights")
    return Command(state=state, floats=floats, pixel_format=pixel_format)


def _lights(value: Any) -> tuple[float, ...]:
    weights = tuple(float(weight) for weight in value)
    if not all(0.0 <= weight < float("inf") for weight in weights):
        raise ValueError("expected finite numbers >= 0")
    return weights


def _picture(value: Any) -> str:
    if value not in _PICTURES:
        raise ValueError(f"expected {', '.join(_PICTURES)}")
    return str(value)


def _share(value: Any) -> float:
    if not 0.0 <= float(value) <= 1.0:
        raise ValueError("expected 0 to 1")
    return float(value)


_STATE_FIELDS: Final[Mapping[str, Callable[[Any], Any]]] = {
    "lights": _lights,
    "picture": _picture,
    "loss": _share,
    "clock_ppm": float,
    "clock_offset_ns": int,
    "skip_frames": int,
}
