"""Between the bus and the hub: light, control states and statuses in; requests of users out."""

from __future__ import annotations

import queue
import threading
import time
from typing import Any

import structlog

from nearfield_protocol.codec import ClientMessage, Encoding, Subscribe, encode_client_message
from nearfield_protocol.errors import ProtocolError
from nearfield_server.bus.keys import CONTROL_REQUEST, CONTROL_STATE, LIGHT_ATLAS, LIGHT_PACKET, STATUS
from nearfield_server.bus.messages import ControlState, parse_object
from nearfield_server.errors import BusError
from nearfield_server.gateway.hub import LightHealth, LightHub
from nearfield_server.gateway.ports import BusClient, ControlRequest
from nearfield_server.gateway.pose import wire_control_state

_PENDING_REQUESTS = 256
_log = structlog.get_logger("nearfield.gateway")


class BusLink:
    """Connects a hub with the bus; it is the `ControlSink` of the application. Close it when done."""

    def __init__(self, bus: BusClient, hub: LightHub) -> None:
        self._bus, self._hub = bus, hub
        self._lock = threading.Lock()
        self._statuses: dict[str, tuple[float, dict[str, Any]]] = {}
        self._control_revision = -1
        self._sequence = 0
        # Sending may wait for the bus; the event loop must not.
        self._requests: queue.Queue[ClientMessage | None] = queue.Queue(_PENDING_REQUESTS)
        self._sender = threading.Thread(target=self._send_requests, name="requests", daemon=True)
        self._sender.start()
        hub.on_atlas_wanted = self._want_atlas
        bus.subscribe(LIGHT_PACKET, self._take_light)
        bus.subscribe(LIGHT_ATLAS, self._take_atlas)
        bus.subscribe(CONTROL_STATE, self._take_control)
        bus.subscribe(f"{STATUS}/*", self._take_status)

    def request(self, request: ControlRequest) -> None:
        """Send a request of a user to the supervisor. With too many unsent ones it is refused and logged."""
        self._enqueue(request)

    def close(self) -> None:
        """Send what waits, then stop."""
        self._requests.put(None)
        self._sender.join(timeout=2.0)

    def statuses(self) -> dict[str, Any]:
        """Newest status of every process, with its age, for `GET /api/status`."""
        now = time.monotonic()
        with self._lock:
            return {
                name: {**status, "status_age_s": round(now - received, 3)}
                for name, (received, status) in self._statuses.items()
            }

    def _want_atlas(self, wanted: bool) -> None:
        self._enqueue(Subscribe(sequence=0, encoding=Encoding.COMPACT, wants_atlas=wanted))

    def _enqueue(self, message: ClientMessage) -> None:
        try:
            self._requests.put_nowait(message)
        except queue.Full:
            _log.warning("control request refused", reason=f"{_PENDING_REQUESTS} requests wait for the bus")

    def _send_requests(self) -> None:
        while (message := self._requests.get()) is not None:
            try:
                self._bus.put(CONTROL_REQUEST, encode_client_message(message), must_arrive=True)
            except BusError as error:
                _log.warning("control request lost", reason=str(error))

    def _take_light(self, _: str, payload: bytes) -> None:
        # An empty packet says that there is no light yet.
        if not payload:
            return
        try:
            self._hub.publish_light(payload)
        except ProtocolError as error:
            _log.warning("light packet refused", reason=str(error))

    def _take_atlas(self, _: str, payload: bytes) -> None:
        try:
            self._hub.publish_atlas(payload)
        except ProtocolError as error:
            _log.warning("atlas tiles refused", reason=str(error))

    def _take_control(self, _: str, payload: bytes) -> None:
        state = ControlState.from_json(payload)
        with self._lock:
            # The supervisor repeats the state for those who missed it. After its restart revisions begin again.
            if state.revision == self._control_revision:
                return
            self._control_revision = state.revision
        self._hub.publish_control(wire_control_state(state))

    def _take_status(self, key: str, payload: bytes) -> None:
        status = parse_object(payload, key)
        now = time.monotonic()
        name = key.rpartition("/")[2]
        with self._lock:
            self._statuses[name] = (now, status)
        if name == "illumination":
            health = light_health(status, now)
            if health is not None:
                self._hub.publish_health(health)


def light_health(status: dict[str, Any], now: float) -> LightHealth | None:
    """Read ages out of the status of the illumination process; None while it prepares."""
    cameras = status.get("cameras")
    if not isinstance(cameras, list):
        return None
    return LightHealth(
        light_age=_age(status.get("light_age_s")),
        camera_ages=tuple(_age(camera.get("age_s")) for camera in cameras if isinstance(camera, dict)),
        is_stale=bool(status.get("stale")),
        reported=now,
    )


def _age(value: Any) -> float:
    return float(value) if isinstance(value, (int, float)) and value >= 0 else float("inf")
