"""The gateway process: `python -m nearfield_server.gateway.process`, started by the supervisor."""

from __future__ import annotations

import asyncio
import os
import socket
import sys
import time
from typing import Any

from nearfield_server.bus.worker import Worker, run_worker
from nearfield_server.gateway.address import describe_address
from nearfield_server.gateway.app import create_app
from nearfield_server.gateway.bus_link import BusLink
from nearfield_server.gateway.camera_summary import summarise_cameras
from nearfield_server.gateway.history import StatusHistory
from nearfield_server.gateway.hub import LightHub
from nearfield_server.gateway.previews import CameraPreviews
from nearfield_server.gateway.scene_builder import ServedScene, build_scene
from nearfield_server.gateway.server import serve_app
from nearfield_server.geometry.cache import load_or_build_texels
from nearfield_server.scene.room_config import load_room

_BEAT_PERIOD_S = 0.25


def prepare_scene(worker: Worker) -> ServedScene:
    """Load the room and prepare its files, with beats in between.

    Raises:
        ConfigError, AssetError: the room file or a file that it names is wrong.
    """

    def progress(text: str) -> None:
        worker.beat("starting", preparing=text)

    room = load_room(worker.spec.room_path)
    progress("room model")
    mesh, texels = load_or_build_texels(room)
    num_vals = worker.spec.options.get("num_vals")
    return build_scene(room, mesh, len(texels.texel_index), num_vals=num_vals, progress=progress)


async def run_gateway(worker: Worker, scene: ServedScene, hub: LightHub, link: BusLink) -> None:
    """Serve until the worker is told to stop.

    Raises:
        ServiceError: the port cannot be had.
    """
    options: dict[str, Any] = worker.spec.options
    lan = bool(options.get("lan"))
    history = StatusHistory()
    app = create_app(
        scene.description,
        hub,
        link,
        allowed_hosts=options.get("allowed_hosts") or (),
        assets=scene.assets,
        lan=lan,
        status=lambda: _status(link),
        history=lambda: history.as_json(time.monotonic()),
        previews=CameraPreviews(worker.bus, scene.camera_ids),
    )
    stop = asyncio.Event()
    listener = socket.socket(fileno=os.dup(int(options["listen_fd"])))
    port: int = listener.getsockname()[1]

    async def beat() -> None:
        announced = False
        while not worker.stop.is_set():
            worker.beat(preparing="", clients=hub.num_clients, atlas_wanted=hub.atlas_wanted)
            if not announced:
                announced = True
                sys.stdout.write(describe_address(port, lan=lan))
                sys.stdout.flush()
            if history.is_due(now_s := time.monotonic()):
                history.sample(now_s, link.statuses(), hub.num_clients)
            await asyncio.sleep(_BEAT_PERIOD_S)
        stop.set()

    beating = asyncio.create_task(beat())
    try:
        await serve_app(app, listener=listener, stop=stop)
    finally:
        beating.cancel()
        await asyncio.gather(beating, return_exceptions=True)


def _status(link: BusLink) -> dict[str, Any]:
    statuses = link.statuses()
    return {"cameras": summarise_cameras(statuses), "processes": statuses}


def main(worker: Worker) -> None:
    """Prepare the room, then serve until told to stop."""
    scene = prepare_scene(worker)
    hub = LightHub(stale_after=scene.description.settings.stale_after_ms / 1000.0)
    link = BusLink(worker.bus, hub)
    hub.metrics.watch_stages(link.statuses)
    hub.metrics.watch_cameras(link.statuses)
    try:
        asyncio.run(run_gateway(worker, scene, hub, link))
    finally:
        link.close()


if __name__ == "__main__":
    sys.exit(run_worker(main))
