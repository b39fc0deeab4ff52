"""The web application: page, REST, assets, metrics and websocket on one port. It has no endpoint that runs anything."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request, WebSocket
from fastapi.responses import FileResponse, JSONResponse, Response
from starlette.exceptions import HTTPException
from starlette.staticfiles import NotModifiedResponse

from nearfield_protocol.layout import VERSION
from nearfield_server.gateway.connection import serve_websocket
from nearfield_server.gateway.hub import LightHub
from nearfield_server.gateway.metrics import CONTENT_TYPE
from nearfield_server.gateway.pages import BUILT_CLIENT, ClientFiles
from nearfield_server.gateway.ports import ControlSink
from nearfield_server.gateway.previews import CameraPreviews, add_preview_routes
from nearfield_server.gateway.scene_description import SceneDescription
from nearfield_server.gateway.security import Guard, HostPolicy

STATUS_PERIOD_S = 0.5
MEDIA_TYPES = {".glb": "model/gltf-binary", ".exr": "image/x-exr"}


def create_app(
    scene: SceneDescription,
    hub: LightHub,
    controls: ControlSink,
    static_dir: Path = BUILT_CLIENT,
    allowed_hosts: Iterable[str] = (),
    *,
    assets: Mapping[str, Path] | None = None,
    lan: bool = False,
    status: Callable[[], dict[str, Any]] | None = None,
    history: Callable[[], dict[str, Any]] | None = None,
    previews: CameraPreviews | None = None,
) -> FastAPI:
    """Build the application.

    Args:
        scene: answer of `GET /api/scene`.
        hub: where light comes from. It is bound to the event loop while the application runs.
        controls: where requests of users go.
        static_dir: the built client.
        allowed_hosts: further host names, see `HostPolicy`.
        assets: URL (`assets/room.glb`) -> file. Nothing else of the file system is served.
        lan: whether the service may be reached by the machine's own addresses.
        status: further entries of `GET /api/status`.
        history: answer of `GET /api/history`, see `history.StatusHistory.as_json`.
        previews: pictures of the cameras, if there are any.
    """

    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        hub.attach(asyncio.get_running_loop())
        heartbeat = asyncio.create_task(_heartbeat(hub))
        try:
            yield
        finally:
            heartbeat.cancel()
            await asyncio.gather(heartbeat, return_exceptions=True)
            hub.detach()

    app = FastAPI(title="Nearfield", docs_url=None, redoc_url=None, openapi_url=None, lifespan=lifespan)
    app.add_middleware(
        Guard, policy=HostPolicy.create(allowed_hosts, lan=lan), on_refused=hub.metrics.refused.inc
    )
    static = ClientFiles(directory=static_dir, html=True, check_dir=False)
    _add_rest(app, scene, hub, status, history)
    if previews is not None:
        add_preview_routes(app, previews)
    _add_files(app, static, dict(assets or {}))

    @app.websocket("/ws")
    async def websocket(websocket: WebSocket) -> None:
        await serve_websocket(websocket, hub, controls)

    app.mount("/", static)
    return app


async def _heartbeat(hub: LightHub) -> None:
    while True:
        hub.send_status()
        await asyncio.sleep(STATUS_PERIOD_S)


def _add_rest(
    app: FastAPI,
    scene: SceneDescription,
    hub: LightHub,
    status: Callable[[], dict[str, Any]] | None,
    history: Callable[[], dict[str, Any]] | None,
) -> None:
    scene_json = scene.model_dump_json()

    @app.get("/api/scene")
    async def get_scene() -> Response:
        return Response(scene_json, media_type="application/json", headers={"Cache-Control": "no-store"})

    @app.get("/api/status")
    async def get_status() -> Response:
        age, camera_ages, is_stale = hub.light_health()
        light = hub.light
        body = {
            "protocol_version": VERSION,
            "clients": hub.num_clients,
            "max_clients": hub.max_clients,
            "light": {
                "sequence": None if light is None else light.sequence,
                "num_bytes": None if light is None else len(light.data),
                "age_s": _finite(age),
                "camera_ages_s": [_finite(value) for value in camera_ages],
                "is_stale": is_stale,
            },
            **(status() if status is not None else {}),
        }
        return JSONResponse(body, headers={"Cache-Control": "no-store"})

    @app.get("/api/history")
    async def get_history() -> Response:
        return JSONResponse(history() if history is not None else {}, headers={"Cache-Control": "no-store"})

    @app.get("/metrics")
    async def get_metrics() -> Response:
        return Response(hub.metrics.render(), headers={"Content-Type": CONTENT_TYPE})


def _add_files(app: FastAPI, static: ClientFiles, assets: dict[str, Path]) -> None:
    @app.api_route("/", methods=["GET", "HEAD"])
    async def get_page(request: Request) -> Response:
        return await static.page("index.html", request)

    @app.api_route("/status", methods=["GET", "HEAD"])
    async def get_status_page(request: Request) -> Response:
        return await static.page("status.html", request)

    @app.api_route("/assets/{path:path}", methods=["GET", "HEAD"])
    async def get_asset(path: str, request: Request) -> Response:
        file = assets.get(f"assets/{path}")
        if file is None:
            # The built client keeps its scripts and styles under the same prefix.
            return await static.get_response(f"assets/{path}", request.scope)
        media_type = MEDIA_TYPES.get(file.suffix, "application/octet-stream")
        try:
            found = await asyncio.to_thread(file.stat)
        except OSError:
            raise HTTPException(404, f"{path} is no longer there") from None
        headers = {"Cache-Control": "no-cache"}
        response = FileResponse(file, media_type=media_type, headers=headers, stat_result=found)
        if static.is_not_modified(response.headers, request.headers):
            return NotModifiedResponse(response.headers)
        return response


def _finite(value: float) -> float | None:
    return round(value, 4) if value < float("inf") else None
