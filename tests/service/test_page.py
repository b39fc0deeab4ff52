"""What a tablet sees: page, scene, and light over the websocket, also across the death of the gateway."""

from __future__ import annotations

import json
import os
import signal
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from tests.service.harness import PATIENCE_S, TINY_ROOM, Service
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from nearfield_protocol.codec import (
    SUBPROTOCOL,
    AtlasTiles,
    ControlState,
    LightPacket,
    Status,
    decode_radiance,
    paste_tiles,
)
from nearfield_protocol.session import ClientSession
from nearfield_server.illumination.atlas_channel import STREAM_SIZE
from nearfield_server.scene.room_config import load_room

pytestmark = pytest.mark.service


class Tablet:
    """A client without a picture."""

    def __init__(self, port: int) -> None:
        self._session = ClientSession()
        self._connecting = connect(
            f"ws://127.0.0.1:{port}/ws",
            subprotocols=[SUBPROTOCOL],  # type: ignore[list-item]
            compression=None,
            proxy=None,
            open_timeout=PATIENCE_S,
        )
        self._socket: ClientConnection
        self.light: LightPacket | None = None
        self.control: ControlState | None = None
        self.status: Status | None = None
        self.atlas = np.zeros((STREAM_SIZE, STREAM_SIZE), np.uint32)
        self.num_tiles = 0

    def __enter__(self) -> Tablet:
        self._socket = self._connecting.__enter__()
        return self

    def __exit__(self, *failure: Any) -> None:
        self._connecting.__exit__(*failure)

    def ask(self, request: Callable[[ClientSession], None]) -> None:
        """Make a request and send it."""
        request(self._session)
        self._flush()

    def _flush(self) -> None:
        for message in self._session.take_outgoing():
            self._socket.send(message)

    def until(self, what: str, condition: Callable[[], Any]) -> None:
        """Receive until `condition()` holds."""
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, f"{what} did not arrive"
            data = self._socket.recv(timeout=PATIENCE_S)
            assert isinstance(data, bytes)
            match self._session.receive(data):
                case LightPacket() as packet:
                    self.light = packet
                case AtlasTiles() as tiles:
                    paste_tiles(self.atlas, tiles)
                    self.num_tiles += len(tiles.positions)
                case ControlState() as state:
                    self.control = state
                case Status() as status:
                    self.status = status
            self._flush()


def _port(service: Service) -> int:
    service.running()
    return int(service.status("supervisor")["port"])


def _get_json(port: int, path: str) -> Any:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=60) as answer:
        return json.load(answer)


def test_the_scene_is_described_and_its_files_are_there(service: Service) -> None:
    port = _port(service)
    scene = _get_json(port, "/api/scene")
    assert scene["room"]["name"] == "tiny"
    assert [light["name"] for light in scene["lights"]] == ["ceiling", "side"]
    for url in [scene["room"]["model_url"], *(item["model_url"] for item in scene["objects"])]:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/{url}", timeout=60) as answer:
            assert answer.read(4) == b"glTF"


def test_light_arrives_and_matches_the_scene(service: Service) -> None:
    port = _port(service)
    scene = _get_json(port, "/api/scene")
    with Tablet(port) as tablet:
        tablet.until("light, state and status", lambda: tablet.light and tablet.control and tablet.status)
        assert tablet.light is not None
        assert tablet.control is not None
        assert tablet.light.room_revision == scene["room"]["revision"]
        assert tablet.light.object_sh.shape[0] == len(scene["objects"]) == len(tablet.control.object_poses)
        assert len(tablet.control.light_weights) == len(scene["lights"])
        tablet.until("fresh light", lambda: tablet.status is not None and not tablet.status.is_stale)


def test_one_tablet_dims_a_lamp_and_another_sees_it(service: Service) -> None:
    port = _port(service)
    with Tablet(port) as first, Tablet(port) as second:
        second.until("light and state", lambda: second.light and second.control)
        assert second.light is not None
        before = second.light.object_sh.copy()
        first.ask(lambda session: session.set_light_weight(1, 0.25))
        second.until(
            "the new weight", lambda: second.control is not None and second.control.light_weights[1] == 0.25
        )
        second.until(
            "dimmer light",
            lambda: second.light is not None and second.light.object_sh[0, 0, 2] < 0.9 * before[0, 0, 2],
        )
        first.ask(lambda session: session.set_light_weight(1, 1.0))
        second.until(
            "the old light",
            lambda: (
                second.light is not None and np.allclose(second.light.object_sh, before, rtol=1e-2, atol=1e-3)
            ),
        )


def test_a_moved_object_comes_back_with_its_pose_revision(service: Service) -> None:
    with Tablet(_port(service)) as tablet:
        tablet.until("state", lambda: tablet.control)
        assert tablet.control is not None
        revision = tablet.control.object_poses[0].pose_revision
        tablet.ask(lambda session: session.set_object_pose(0, (0.5, 0.25, 0.5), (0.0, 0.0, 0.0, 1.0)))
        tablet.until(
            "light at the new pose",
            lambda: tablet.light is not None and int(tablet.light.object_revisions[0]) > revision,
        )


def test_the_atlas_travels_only_while_a_tablet_wants_it(service: Service) -> None:
    port = _port(service)
    service.wait("no wish", lambda: service._statuses.get("illumination", {}).get("atlas_wanted") is False)
    with Tablet(port) as tablet:
        tablet.ask(lambda session: session.subscribe(wants_atlas=True))
        tablet.until("the whole atlas", lambda: tablet.num_tiles >= 64)
        radiance = decode_radiance(tablet.atlas)
        assert np.isfinite(radiance).all()
        assert radiance.max() > 0
        with Tablet(port) as late:
            late.ask(lambda session: session.subscribe(wants_atlas=True))
            late.until("the whole atlas", lambda: late.num_tiles >= 64)
            np.testing.assert_array_equal(late.atlas, tablet.atlas)
    service.wait("no more wish", lambda: service._statuses["illumination"]["atlas_wanted"] is False)


def test_a_killed_gateway_comes_back_on_the_same_port(
    service: Service, record_property: Callable[[str, object], None]
) -> None:
    port = _port(service)
    pids = service.running()
    service.forget()
    killed_s = time.monotonic()
    os.kill(pids["gateway"], signal.SIGKILL)
    # The supervisor holds the port: this connection waits for the new gateway instead of being refused.
    with Tablet(port) as tablet:
        tablet.until("light", lambda: tablet.light)
    record_property("seconds_to_light", round(time.monotonic() - killed_s, 2))
    assert service.running()["gateway"] != pids["gateway"]


def test_every_camera_shows_a_preview(service: Service) -> None:
    port = _port(service)
    for camera in load_room(TINY_ROOM).cameras:
        url = f"http://127.0.0.1:{port}/api/cameras/{camera.camera_id}/preview.jpg?size=32&marks=0"
        with urllib.request.urlopen(url, timeout=60) as answer:
            picture = cv2.imdecode(np.frombuffer(answer.read(), np.uint8), cv2.IMREAD_COLOR)
        assert max(picture.shape[:2]) == min(32, max(camera.intrinsics.height, camera.intrinsics.width))
        assert len(np.unique(picture)) > 16


def test_status_names_every_process(service: Service) -> None:
    port = _port(service)
    expected = {"cam0", "cam1", "illumination", "supervisor"}
    service.wait("all statuses", lambda: set(_get_json(port, "/api/status")["processes"]) >= expected)
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(f"http://127.0.0.1:{port}/assets/../pyproject.toml", timeout=60)


def test_tablets_are_told_that_the_service_restarts(start_service: Callable[..., Service]) -> None:
    service = start_service()
    with Tablet(_port(service)) as tablet:
        tablet.until("light", lambda: tablet.light)
        service.process.send_signal(signal.SIGTERM)
        with pytest.raises(ConnectionClosed) as closed:
            tablet.until("the end", lambda: False)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1012
    assert service.process.wait(timeout=PATIENCE_S) == 0
