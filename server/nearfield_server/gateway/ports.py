"""What the gateway needs from the rest of the service."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from nearfield_protocol.codec import SetLightWeight, SetObjectPose

ControlRequest = SetLightWeight | SetObjectPose


class ControlSink(Protocol):
    """Where requests of users go. Called on the event loop: must not block."""

    def request(self, request: ControlRequest) -> None:
        """Take one request; the answer is a new control state, published through the hub."""


class BusClient(Protocol):
    """The part of the message bus that the gateway uses; keys are relative to the room."""

    def put(self, key: str, payload: bytes, *, must_arrive: bool = False) -> None:
        """Send to all subscribers of a key."""

    def subscribe(self, key: str, callback: Callable[[str, bytes], None]) -> None:
        """Call `callback(key, payload)` for every message, in a thread of the bus."""


class NoControls:
    """A sink for services in which nothing can be changed."""

    def request(self, request: ControlRequest) -> None:
        """Ignore the request; clients see that the control state stays."""
