"""The client page in headless Chromium, served by a small gateway of the tests."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from nearfield_protocol.codec import (
    SUBPROTOCOL,
    VAL_DTYPE,
    VERSION,
    ClientMessage,
    ControlState,
    LightPacket,
    Status,
    WirePose,
    decode_client_message,
    encode_control_state,
    encode_light_packet,
    encode_status,
)

BROWSER_ARGUMENTS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
ROOT = Path(__file__).parents[2]
CLIENT = ROOT / "client_web"
CONTENT_SECURITY_POLICY = b"default-src 'self'"
LOOKING_ALONG_MINUS_Z = [1, 0, 0, 2, 0, -1, 0, 0.8, 0, 0, -1, 4, 0, 0, 0, 1]


def example_scene() -> dict[str, Any]:
    """Three views, two lamps and two objects on the floor of a 4 m room."""
    poses = [[1, 0, 0, x, 0, 1, 0, 0, 0, 0, 1, 1.5, 0, 0, 0, 1] for x in (1.5, 2.6)]
    return {
        "protocol_version": VERSION,
        "room": {
            "name": "test room",
            "model_url": "assets/room.glb",
            "revision": 1,
            "atlas": {"width": 64, "height": 64, "texels": 4096},
            "bounds": {"minimum": [0, 0, 0], "size": [4, 2.5, 4]},
        },
        "objects": [
            {
                "index": i,
                "name": name,
                "model_url": f"assets/objects/{name}.glb",
                "albedo": [0.7, 0.7, 0.7],
                "world_from_object": poses[i],
            }
            for i, name in enumerate(("bunny", "dragon"))
        ],
        "views": [
            {
                "index": i,
                "id": str(i),
                "width": 960,
                "height": 540,
                "fx": 600 + 100 * i,
                "fy": 600 + 100 * i,
                "cx": 479.5,
                "cy": 269.5,
                "world_from_camera": LOOKING_ALONG_MINUS_Z,
                "background_urls": [f"assets/views/{i}_{k}.exr" for k in range(2)],
            }
            for i in range(3)
        ],
        "lights": [
            {
                "index": 0,
                "name": "ceiling_light",
                "radiance": [15, 13, 10],
                "basis_radiance": 100,
                "weight": 1,
            },
            {"index": 1, "name": "window", "radiance": [2, 2.4, 3], "basis_radiance": 100, "weight": 0.5},
        ],
        "settings": {"num_vals": 16, "exposure": None, "stale_after_ms": 1000},
    }


@dataclass
class FakeGateway:
    """Serves a page, a scene and light packets; everything that a page sends is kept in `received`."""

    scene: dict[str, Any]
    static_dir: Path
    received: list[ClientMessage] = field(default_factory=list)
    accepting: bool = True
    light_weights: list[float] = field(default_factory=list)
    sequence: int = 0
    room_revision: int = 1
    port: int = 0
    connections: int = 0
    processes: dict[str, Any] = field(default_factory=dict)
    status_requests: int = 0
    _sockets: list[WebSocket] = field(default_factory=list)
    _loop: asyncio.AbstractEventLoop | None = None

    def __post_init__(self) -> None:
        self.light_weights = [light["weight"] for light in self.scene["lights"]]

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    def messages(self, kind: type[ClientMessage]) -> list[Any]:
        return [message for message in self.received if isinstance(message, kind)]

    def light_packet(self, radiant_intensity: float) -> bytes:
        """One lamp below the ceiling, in the next packet."""
        self.sequence += 1
        vals = np.zeros(2, VAL_DTYPE)
        vals["normal"] = (0, -1, 0)
        vals["position"] = (2, 2.4, 2)
        vals["area"] = 0.04
        vals["radiant_intensity"][0] = radiant_intensity
        count = len(self.scene["objects"])
        return encode_light_packet(
            LightPacket(
                sequence=self.sequence,
                timestamp_ns=time.monotonic_ns(),
                room_revision=self.room_revision,
                vals=vals,
                object_sh=np.full((count, 9, 3), 0.5, np.float32),
                object_revisions=np.zeros(count, np.uint32),
                bounds_min=np.zeros(3, np.float32),
                bounds_size=np.full(3, 4, np.float32),
            )
        )

    def control_state(self) -> bytes:
        poses = [
            WirePose(
                pose_revision=0,
                position=tuple(each["world_from_object"][3:12:4]),
                quaternion=(0.0, 0.0, 0.0, 1.0),
            )
            for each in self.scene["objects"]
        ]
        return encode_control_state(
            ControlState(
                sequence=1, revision=1, light_weights=tuple(self.light_weights), object_poses=tuple(poses)
            )
        )

    def send(self, data: bytes) -> None:
        """To every page that is connected."""
        assert self._loop is not None

        async def send_all() -> None:
            for socket in list(self._sockets):
                with suppress(RuntimeError, WebSocketDisconnect):
                    await socket.send_bytes(data)

        asyncio.run_coroutine_threadsafe(send_all(), self._loop).result(5)

    def disconnect(self, code: int, reason: str = "") -> None:
        """Close every connection."""
        assert self._loop is not None

        async def close_all() -> None:
            for socket in list(self._sockets):
                with suppress(RuntimeError):
                    await socket.close(code, reason)

        asyncio.run_coroutine_threadsafe(close_all(), self._loop).result(5)

    def app(self) -> ASGIApp:
        async def scene(_request: Request) -> Response:
            return JSONResponse(self.scene)

        async def status(_request: Request) -> Response:
            self.status_requests += 1
            return JSONResponse({"protocol_version": VERSION, "processes": self.processes})

        return _with_policy(
            Starlette(
                routes=[
                    Route("/api/scene", scene),
                    Route("/api/status", status),
                    WebSocketRoute("/ws", self._serve_socket),
                    Mount("/", StaticFiles(directory=self.static_dir, html=True)),
                ]
            )
        )

    async def _serve_socket(self, socket: WebSocket) -> None:
        self._loop = asyncio.get_running_loop()
        if not self.accepting:
            await socket.close(1013)
            return
        await socket.accept(SUBPROTOCOL)
        self.connections += 1
        self._sockets.append(socket)
        heartbeat = asyncio.create_task(self._heartbeat(socket))
        try:
            await socket.send_bytes(self.control_state())
            await socket.send_bytes(self.light_packet(8.0))
            while True:
                self.received.append(decode_client_message(await socket.receive_bytes()))
        except (WebSocketDisconnect, RuntimeError, KeyError):
            pass
        finally:
            heartbeat.cancel()
            self._sockets.remove(socket)

    async def _heartbeat(self, socket: WebSocket) -> None:
        with suppress(RuntimeError, WebSocketDisconnect):
            for sequence in range(1_000_000):
                status = Status(
                    sequence=sequence,
                    server_time_ns=time.monotonic_ns(),
                    light_age=0.03,
                    camera_ages=(0.03,),
                    is_stale=False,
                )
                await socket.send_bytes(encode_status(status))
                await asyncio.sleep(0.5)


def _with_policy(app: ASGIApp) -> ASGIApp:
    async def wrapped(scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_policy(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"].append((b"content-security-policy", CONTENT_SECURITY_POLICY))
            await send(message)

        await app(scope, receive, send_with_policy)

    return wrapped


def build_page(folder: Path, *arguments: str) -> Path:
    """Run vite in the client's folder."""
    npx = shutil.which("npx") or str(ROOT / ".venv/bin/npx")
    if not (CLIENT / "node_modules").is_dir() or not Path(npx).exists():
        pytest.skip("needs Node and `npm ci` in client_web")
    result = subprocess.run(
        [npx, "vite", "build", *arguments],
        cwd=CLIENT,
        env={**os.environ, "OUT_DIR": str(folder), "PATH": f"{Path(npx).parent}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return folder


@pytest.fixture(scope="session")
def page_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page with a stand-in renderer, built once."""
    standin = Path(__file__).parent / "standin"
    folder = tmp_path_factory.mktemp("page")
    return build_page(folder, str(standin), "--config", str(standin / "vite.config.mjs"))


@pytest.fixture(scope="session")
def real_page_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page as it ships, built once."""
    folder = tmp_path_factory.mktemp("real_page")
    return build_page(folder, "--outDir", str(folder), "--logLevel", "warn")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        instance = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=BROWSER_ARGUMENTS)
        yield instance
        instance.close()


@pytest.fixture
def serve(page_dir: Path) -> Iterator[Callable[[dict[str, Any]], FakeGateway]]:
    """Starts gateways; they stop with the test."""
    running: list[tuple[uvicorn.Server, threading.Thread]] = []

    def start(scene: dict[str, Any]) -> FakeGateway:
        gateway = FakeGateway(scene=json.loads(json.dumps(scene)), static_dir=page_dir)
        config = uvicorn.Config(
            gateway.app(),
            host="127.0.0.1",
            port=0,
            log_level="warning",
            ws="websockets-sansio",
            lifespan="off",
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        deadline = time.monotonic() + 20
        while not server.started:
            assert time.monotonic() < deadline, "the test gateway did not start"
            time.sleep(0.01)
        gateway.port = server.servers[0].sockets[0].getsockname()[1]
        running.append((server, thread))
        return gateway

    yield start
    for server, thread in running:
        server.should_exit = True
        server.force_exit = True
        thread.join(10)


@pytest.fixture
def scene() -> dict[str, Any]:
    return example_scene()


@pytest.fixture
def gateway(serve: Callable[[dict[str, Any]], FakeGateway], scene: dict[str, Any]) -> FakeGateway:
    return serve(scene)
