"""Typed messages of the bus. Light packets and control requests are bytes of the wire protocol (protocol/SPEC.md); the rest is JSON."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import BusError
from nearfield_server.records import ObjectPlacement


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlState:
    """What users have set; the supervisor alone changes it.

    Attributes:
        revision: counts up with every change.
        light_weights: one per switchable light, >= 0.
        objects: one per object of the room file.
        atlas_wanted: whether any client asks for the room's radiance atlas.
        started_ns: CLOCK_MONOTONIC at which every process of the service ran for the first time; 0 until then. Recorded cameras begin
            together at it.
    """

    revision: int
    light_weights: tuple[float, ...]
    objects: tuple[ObjectPlacement, ...]
    atlas_wanted: bool = False
    started_ns: int = 0

    def to_json(self) -> bytes:
        """Serialise; `from_json` gives back an equal state."""
        return json.dumps(
            {
                "revision": self.revision,
                "light_weights": list(self.light_weights),
                "objects": [
                    {"revision": o.revision, "world_from_object": o.world_from_object.tolist()}
                    for o in self.objects
                ],
                "atlas_wanted": self.atlas_wanted,
                "started_ns": str(self.started_ns),
            },
            allow_nan=False,
        ).encode()

    @classmethod
    def from_json(cls, payload: bytes) -> ControlState:
        """Parse and check.

        Raises:
            BusError: not JSON, or a field is missing or impossible.
        """
        message = parse_object(payload, "control/state")
        try:
            return cls(
                revision=int(message["revision"]),
                light_weights=tuple(_weight(weight) for weight in message["light_weights"]),
                objects=tuple(
                    ObjectPlacement(
                        revision=int(entry["revision"]), world_from_object=_pose(entry["world_from_object"])
                    )
                    for entry in message["objects"]
                ),
                atlas_wanted=bool(message["atlas_wanted"]),
                started_ns=int(message.get("started_ns", 0)),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise BusError(f"control/state: malformed ({type(error).__name__}: {error})") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class PreviewRequest:
    """Question for a small picture of a camera's newest frame.

    Attributes:
        max_side: longer side of the picture, 16 to 1024 pixels.
        stops: brighter (+) or darker (-) than chosen from the picture, powers of two, -20 to 20.
        marks: paint pixels that are no measurement in colours of their own.
    """

    max_side: int = 384
    stops: float = 0.0
    marks: bool = True

    def to_json(self) -> bytes:
        """Serialise; `from_json` gives back an equal request."""
        return json.dumps({"max_side": self.max_side, "stops": self.stops, "marks": self.marks}).encode()

    @classmethod
    def from_json(cls, payload: bytes) -> PreviewRequest:
        """Parse and check.

        Raises:
            BusError: not JSON, or a field is missing or impossible.
        """
        message = parse_object(payload, "preview")
        try:
            request = cls(
                max_side=int(message["max_side"]),
                stops=float(message["stops"]),
                marks=bool(message["marks"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise BusError(f"preview: malformed ({type(error).__name__}: {error})") from error
        if not 16 <= request.max_side <= 1024 or not -20.0 <= request.stops <= 20.0:
            raise BusError(
                f"preview: expected max_side from 16 to 1024 and stops from -20 to 20, found {request.max_side} and {request.stops}"
            )
        return request


def _weight(value: Any) -> float:
    weight = float(value)
    if not (math.isfinite(weight) and weight >= 0):
        raise ValueError(f"light weight {value}, expected a finite number >= 0")
    return weight


def _pose(value: Any) -> NDArray[np.float64]:
    pose = np.asarray(value, np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ValueError(f"world_from_object of shape {pose.shape}, expected (4, 4) finite numbers")
    return pose


def parse_object(payload: bytes, key: str) -> dict[str, Any]:
    """Parse a JSON object.

    Raises:
        BusError: not a JSON object.
    """
    try:
        message = json.loads(payload)
    except ValueError as error:
        raise BusError(f"{key}: not JSON ({error})") from error
    if not isinstance(message, dict):
        raise BusError(f"{key}: {type(message).__name__}, expected a JSON object")
    return message


def status_json(status: dict[str, Any]) -> bytes:
    """Serialise a status message; numbers that JSON does not have (infinity, NaN) become null, numpy scalars plain numbers."""
    return json.dumps(_plain(status), allow_nan=False).encode()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def room_revision(content_hash: str) -> int:
    """Return the number that light packets and the scene description share: the first 32 bits of `RoomMesh.content_hash`."""
    return int(content_hash[:8], 16)
