"""The page on which a person connects cameras: a small application of its own, on loopback, that ends with the command that started it."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, ConfigDict, Field

from nearfield_server.errors import AssetError, CaptureError, ConfigError, NearfieldError
from nearfield_server.gateway.pages import BUILT_CLIENT, ClientFiles
from nearfield_server.gateway.security import Guard, HostPolicy
from nearfield_server.onboarding.connected import Connected, Listing
from nearfield_server.onboarding.look import Look
from nearfield_server.onboarding.session import CameraChoice, SetupSession
from nearfield_server.onboarding.source_plan import choose_pixel_format
from nearfield_server.onboarding.viewer import Wish

_NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
_NO_STORE = {"Cache-Control": "no-store"}


class ChosenCamera(BaseModel):
    """One camera of a request to write the room; see `CameraChoice`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    index: Annotated[int, Field(ge=0)]
    id: Annotated[str, Field(pattern=_NAME)]
    pixel_format: Annotated[str, Field(max_length=64)] | None = None
    exposure_s: Annotated[float, Field(gt=0, le=60, allow_inf_nan=False)] | None = None
    field_degrees: Annotated[float, Field(ge=30, le=300, allow_inf_nan=False)] = 180.0


class RoomRequest(BaseModel):
    """Body of `POST /api/setup/room`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cameras: Annotated[tuple[ChosenCamera, ...], Field(min_length=1, max_length=8)]
    name: Annotated[str, Field(max_length=64)] = ""
    model: Annotated[str, Field(max_length=512)] = ""
    overwrite: bool = False


def create_setup_app(session: SetupSession, static_dir: Path = BUILT_CLIENT) -> FastAPI:
    """Build the application.

    Args:
        session: what it shows and writes. The path of the room file is the session's: no request can name another.
        static_dir: the built client.
    """
    app = FastAPI(title="Nearfield set-up", docs_url=None, redoc_url=None, openapi_url=None)
    app.add_middleware(Guard, policy=HostPolicy.create(), on_refused=lambda: None)
    static = ClientFiles(directory=static_dir, html=True, check_dir=False)

    @app.api_route("/", methods=["GET", "HEAD"])
    async def get_page(request: Request) -> Response:
        return await static.page("setup.html", request)

    @app.get("/api/setup")
    async def get_state() -> Response:
        return await _answer(lambda: _state(session, session.listing))

    @app.post("/api/setup/search")
    async def search() -> Response:
        return await _answer(lambda: _state(session, session.search()))

    @app.get("/api/setup/cameras/{index}/look")
    async def look(
        index: int,
        exposure_s: Annotated[float | None, Query(gt=0, le=60, allow_inf_nan=False)] = None,
        pixel_format: Annotated[str | None, Query(max_length=64)] = None,
        marks: bool = True,
    ) -> Response:
        wish = Wish(exposure_s=exposure_s, marks=marks)
        return await _answer(lambda: _look(session.look(index, wish, pixel_format)))

    @app.post("/api/setup/cameras/{index}/expose")
    async def expose(
        index: int, pixel_format: Annotated[str | None, Query(max_length=64)] = None
    ) -> Response:
        return await _answer(lambda: _look(session.expose(index, pixel_format)))

    @app.post("/api/setup/room")
    async def write(request: RoomRequest) -> Response:
        return await _answer(lambda: _write(session, request))

    app.mount("/", static)
    return app


async def _answer(make: Callable[[], dict[str, Any]]) -> Response:
    """What `make()` returns, as JSON; errors in words with the status that fits them. Cameras and disks may take their time."""
    try:
        return JSONResponse(await asyncio.to_thread(make), headers=_NO_STORE)
    except (ConfigError, AssetError) as error:
        return JSONResponse({"error": str(error)}, status_code=409, headers=_NO_STORE)
    except CaptureError as error:
        return JSONResponse({"error": str(error)}, status_code=503, headers=_NO_STORE)
    except NearfieldError as error:
        return JSONResponse({"error": str(error)}, status_code=500, headers=_NO_STORE)


def _state(session: SetupSession, listing: Listing) -> dict[str, Any]:
    room = session.room()
    return {
        "room": {
            "path": str(room.path),
            "exists": room.exists,
            "problem": room.problem,
            "camera_ids": room.camera_ids,
            "default_name": session.default_name,
        },
        "models": session.models(),
        "notes": listing.notes,
        "cameras": [
            _camera(index, camera, camera.place in room.places)
            for index, camera in enumerate(listing.cameras)
        ],
    }


def _camera(index: int, camera: Connected, is_in_room: bool) -> dict[str, Any]:
    return {
        "index": index,
        "kind": camera.kind,
        "place": camera.place,
        "name": camera.name,
        "serial": camera.serial,
        "state": camera.state,
        "advice": camera.advice,
        "pixel_formats": camera.pixel_formats,
        "pixel_format": choose_pixel_format(camera.kind, camera.pixel_formats),
        "is_in_room": is_in_room,
    }


def _look(look: Look) -> dict[str, Any]:
    lens = look.lens
    return {
        "picture": "data:image/jpeg;base64," + base64.b64encode(look.jpeg).decode(),
        "width": look.width,
        "height": look.height,
        "pixel_format": look.pixel_format,
        "exposure_s": look.exposure_s,
        "exposure_range_s": look.exposure_range_s,
        "histogram": look.histogram,
        "saturated_share": look.saturated_share,
        "circle": {"x": lens.cx, "y": lens.cy, "radius": lens.fx * lens.theta_max}
        if look.has_circle
        else None,
    }


def _write(session: SetupSession, request: RoomRequest) -> dict[str, Any]:
    choices = [
        CameraChoice(
            index=camera.index,
            camera_id=camera.id,
            pixel_format=camera.pixel_format,
            exposure_s=camera.exposure_s,
            field_degrees=camera.field_degrees,
        )
        for camera in request.cameras
    ]
    model = session.model_path(request.model)
    room = session.write(choices, name=request.name, model=model, overwrite=request.overwrite)
    return {
        "path": str(session.room_path),
        "cameras": [camera.camera_id for camera in room.cameras],
        "next": f"nearfield doctor {session.room_path}",
    }
