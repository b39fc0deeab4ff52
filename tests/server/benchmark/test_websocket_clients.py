"""Clients of the benchmark against the real gateway."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np

from nearfield_protocol import codec
from nearfield_server.gateway.app import create_app
from nearfield_server.gateway.hub import LightHub
from nearfield_server.gateway.ports import NoControls
from nearfield_server.gateway.scene_description import SceneDescription
from nearfield_server.gateway.server import serve_in_thread


def _packet() -> bytes:
    vals = np.zeros(4, codec.VAL_DTYPE)
    vals["normal"], vals["position"], vals["radiant_intensity"] = (0, 1, 0), 0.5, 1.0
    return codec.encode_light_packet(
        codec.LightPacket(
            sequence=1,
            timestamp_ns=1,
            room_revision=7,
            vals=vals,
            object_sh=np.zeros((0, 9, 3), np.float32),
            object_revisions=np.zeros(0, np.uint32),
            bounds_min=np.zeros(3, np.float32),
            bounds_size=np.ones(3, np.float32),
        )
    )


def test_all_clients_stay_until_their_input_ends() -> None:
    scene = SceneDescription.model_validate(
        {
            "protocol_version": 1,
            "room": {
                "name": "tiny",
                "model_url": "assets/room.glb",
                "revision": 7,
                "atlas": {"width": 64, "height": 64, "texels": 10},
                "bounds": {"minimum": [0, 0, 0], "size": [1, 2, 3]},
            },
        }
    )
    hub = LightHub()
    hub.publish_light(_packet())
    with serve_in_thread(create_app(scene, hub, NoControls())) as url:
        command = [sys.executable, "-m", "nearfield_server.benchmark.websocket_clients"]
        with subprocess.Popen(
            [*command, url.replace("http", "ws", 1) + "ws", "3"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as clients:
            assert clients.stdout is not None
            assert clients.stdin is not None
            assert clients.stdout.readline() == "ready\n"
            assert hub.num_clients == 3
            clients.stdin.close()
            assert clients.wait(60) == 0
        deadline = time.monotonic() + 10
        while hub.num_clients and time.monotonic() < deadline:
            time.sleep(0.01)
        assert hub.num_clients == 0
