"""A small scene and real websockets on loopback."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect

from nearfield_protocol import codec
from nearfield_protocol.session import ClientSession, SessionLimits
from nearfield_server.gateway.app import create_app
from nearfield_server.gateway.hub import LightHub
from nearfield_server.gateway.ports import ControlRequest
from nearfield_server.gateway.scene_description import SceneDescription
from nearfield_server.gateway.server import serve_in_thread

IDENTITY = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


def scene_json() -> dict[str, Any]:
    return {
        "protocol_version": 1,
        "room": {
            "name": "tiny",
            "model_url": "assets/room.glb",
            "revision": 7,
            "atlas": {"width": 64, "height": 64, "texels": 10},
            "bounds": {"minimum": [0, 0, 0], "size": [1, 2, 3]},
        },
        "objects": [
            {
                "index": 0,
                "name": "bunny",
                "model_url": "assets/objects/bunny.glb",
                "albedo": [0.5, 0.5, 0.5],
                "world_from_object": IDENTITY,
            }
        ],
        "views": [],
        "lights": [{"index": 0, "name": "lamp", "radiance": [1, 1, 1], "basis_radiance": 1.0}],
    }


def light_bytes(sequence: int, num_vals: int = 16) -> bytes:
    vals = np.zeros(num_vals, codec.VAL_DTYPE)
    vals["normal"], vals["position"], vals["radiant_intensity"] = (0, 1, 0), 0.5, 1 + sequence % 97
    return codec.encode_light_packet(
        codec.LightPacket(
            sequence=sequence,
            timestamp_ns=sequence,
            room_revision=7,
            vals=vals,
            object_sh=np.full((1, 9, 3), 0.25, np.float32),
            object_revisions=np.zeros(1, np.uint32),
            bounds_min=np.zeros(3, np.float32),
            bounds_size=np.ones(3, np.float32),
        )
    )


def atlas_bytes(value: int, places: list[tuple[int, int]], tiles: int = 8) -> bytes:
    return codec.encode_atlas_tiles(
        codec.AtlasTiles(
            sequence=1,
            timestamp_ns=1,
            width=32 * tiles,
            height=32 * tiles,
            positions=np.array(places, np.uint16),
            texels=np.full((len(places), 32, 32), value, np.uint32),
        )
    )


@dataclass
class Requests:
    """A control sink that remembers."""

    taken: list[ControlRequest] = field(default_factory=list)

    def request(self, request: ControlRequest) -> None:
        self.taken.append(request)


@dataclass
class Tablet:
    """A client: the real session over a real websocket."""

    websocket: ClientConnection
    session: ClientSession = field(default_factory=ClientSession)

    def flush(self) -> None:
        for data in self.session.take_outgoing():
            self.websocket.send(data)

    def read(self, timeout: float = 5.0, acknowledge: bool = True) -> Any:
        message = self.session.receive(self.websocket.recv(timeout))
        if acknowledge:
            self.flush()
        return message

    def read_until(
        self, kind: type, condition: Callable[[Any], bool] = lambda _: True, **options: Any
    ) -> Any:
        while True:
            message = self.read(**options)
            if isinstance(message, kind) and condition(message):
                return message


@dataclass
class Gateway:
    """A running gateway and what belongs to it."""

    hub: LightHub
    requests: Requests
    url: str
    stack: ExitStack
    stop: Callable[[], None]

    @property
    def port(self) -> int:
        return int(self.url.rstrip("/").rpartition(":")[2])

    def tablet(self, **options: Any) -> Tablet:
        settings: dict[str, Any] = {
            "subprotocols": ["nearfield.v1"],
            "compression": None,
            "proxy": None,
            **options,
        }
        uri = self.url.replace("http", "ws") + "ws"
        return Tablet(self.stack.enter_context(connect(uri, **settings)))

    def raw(self, request: str) -> bytes:
        """Send bytes as they are, return everything that comes back."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=5) as connection:
            connection.sendall(request.replace("\n", "\r\n").encode())
            parts = []
            while part := connection.recv(65536):
                parts.append(part)
            return b"".join(parts)


StartGateway = Callable[..., Gateway]


@pytest.fixture
def start_gateway(tmp_path: Path) -> Iterator[StartGateway]:
    with ExitStack() as stack:

        def start(
            *,
            limits: SessionLimits | None = None,
            max_clients: int = 32,
            user_timeout_ms: int = 5000,
            **options: Any,
        ) -> Gateway:
            hub = LightHub(limits=limits, max_clients=max_clients)
            requests = Requests()
            scene = SceneDescription.model_validate(scene_json())
            options.setdefault("static_dir", tmp_path / "static")
            app = create_app(scene, hub, requests, **options)
            server = stack.enter_context(ExitStack())
            url = server.enter_context(serve_in_thread(app, user_timeout_ms=user_timeout_ms))
            return Gateway(hub, requests, url, stack, server.close)

        yield start
