"""Cameras of another machine: joined, cut off, rejoined; who may say what; and what comes is what the camera saw, bit for bit."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cameras.harness import in_place_of, wait_until, write_device_room
from tests.cameras.two_hosts import CLOCK_OFFSET_S, OtherHost, Process
from tests.service.harness import TINY_ROOM, Service

from nearfield_server.capture.cameras import make_source
from nearfield_server.capture.ingest import as_words, ingest_frame
from nearfield_server.capture.remote.certificates import (
    CertificateFiles,
    new_node,
    new_room,
    why_no_connection,
)
from nearfield_server.capture.remote.gate import room_gate_config
from nearfield_server.capture.remote.links import (
    RemoteLink,
    local_config,
    node_config,
    open_session,
    remote_key,
)
from nearfield_server.capture.remote.source import RemoteCamera, RemoteSource
from nearfield_server.capture.source import RawFrame
from nearfield_server.errors import AwayError, BusError
from nearfield_server.scene.room_config import RoomConfig, load_room
from nearfield_server.supervisor.launcher import free_loopback_port

pytestmark = pytest.mark.cameras

SUBNET = "192.168.77"
PORT = 7448
DETECTION_LIMIT_S = 10.0
"""Generous: the machine of the tests may be busy. The product's own limit is `silence_limit_s`."""


@pytest.fixture(scope="module")
def host() -> Iterator[OtherHost]:
    other = OtherHost(SUBNET)
    yield other
    other.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Room file and certificates of a room whose two cameras are those of the nodes `window` and `door`."""
    folder = tmp_path_factory.mktemp("room")
    certificates = folder / "certificates"
    new_room(certificates, [f"{SUBNET}.1"])
    for node in ("window", "door", "stranger"):
        new_node(certificates, node)
    write_device_room(
        folder,
        TINY_ROOM,
        in_place_of(
            TINY_ROOM, [{"kind": "remote", "node": node, "camera": "cam"} for node in ("window", "door")]
        ),
        frame_rate=10.0,
        remote={"listen": f"{SUBNET}.1:{PORT}", "certificates": "certificates"},
    )
    return folder


def write_node(folder: Path, node: str, camera_index: int, **camera_keys: Any) -> Path:
    """Node file of one machine with one lab camera of the tiny room."""
    room = load_room(TINY_ROOM)
    intrinsics = room.cameras[camera_index].intrinsics
    files = [str(path.resolve()) for path in room.sources[camera_index].files]
    keys = {"id": "cam", "width": intrinsics.width, "height": intrinsics.height, **camera_keys}
    lines = [
        "format = 1",
        f'node = "{node}"',
        f'room = "{room.name}"',
        f'connect = "{SUBNET}.1:{PORT}"',
        'certificates = "certificates"',
        "frame_rate = 10.0",
        "[[cameras]]",
        *(f"{key} = {json.dumps(value)}" for key, value in keys.items()),
        f'source = {{ kind = "lab", files = {json.dumps(files)} }}',
    ]
    for light in room.lights:
        lines += [
            "[[lights]]",
            f'name = "{light.name}"',
            f"radiance = {list(light.radiance)}",
            f"basis_radiance = {light.basis_radiance}",
        ]
    path = folder / f"{node}.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def room(folder: Path, host: OtherHost) -> RoomConfig:
    del host  # its address must be there
    return load_room(folder)


@pytest.fixture
def gate(room: RoomConfig) -> Iterator[int]:
    """The gate of the room in this process; yields its port on loopback."""
    port = free_loopback_port()
    session = open_session(room_gate_config(room, port), "gate")
    yield port
    session.close()


class Watcher:
    """Does with a remote source what the capture loop does, and keeps what it saw."""

    def __init__(self, room: RoomConfig, gate_port: int, node: str = "window") -> None:
        intrinsics = room.cameras[0].intrinsics
        self.height, self.width = intrinsics.height, intrinsics.width
        camera = RemoteCamera(
            camera_id="0",
            room=room.name,
            node=node,
            camera="cam",
            height=self.height,
            width=self.width,
            frame_rate=room.frame_rate,
            gate_port=gate_port,
        )
        self.source = RemoteSource(camera)
        self.source.open()
        self._stop = threading.Event()

    def frame(self, wanted: Callable[[RawFrame], bool] = lambda _: True) -> RawFrame:
        """Wait for a frame, whatever goes wrong before it comes."""

        def look() -> RawFrame | None:
            self.source.wait_for_frame(self._stop, 0.1)
            try:
                frame = self.source.next_frame(time.monotonic_ns())
            except AwayError:
                self.source.close()
                self.source.open()
                return None
            return frame if frame is not None and wanted(frame) else None

        found: RawFrame = wait_until("a frame", look)
        return found

    def away(self) -> str:
        """Wait until no frames come and return what the source says then."""
        end = time.monotonic() + DETECTION_LIMIT_S
        while time.monotonic() < end:
            self.source.wait_for_frame(self._stop, 0.1)
            try:
                self.source.next_frame(time.monotonic_ns())
            except AwayError as error:
                return str(error)
        raise AssertionError("the source says nothing although no frames come")

    def words(self, frame: RawFrame) -> NDArray[np.uint64]:
        """The frame as the ring of the service gets it."""
        clean = np.empty((self.height, self.width, 4), np.float16)
        ingest_frame(frame.pixels, clean)
        return as_words(clean).copy()


def local_words(weights: tuple[float, ...], camera_index: int = 0) -> NDArray[np.uint64]:
    """What a local camera would put into its ring."""
    room = load_room(TINY_ROOM)
    source = make_source(room, camera_index, {})
    source.open()
    source.set_light_weights(weights)
    frame = source.next_frame(0)
    assert frame is not None
    clean = np.empty((*frame.pixels.shape[:2], 4), np.float16)
    ingest_frame(frame.pixels, clean)
    return as_words(clean)


def test_a_camera_of_another_machine_is_like_a_local_one(
    folder: Path, room: RoomConfig, gate: int, host: OtherHost, tmp_path: Path
) -> None:
    watcher = Watcher(room, gate)
    assert "has never joined" in watcher.away()
    node = host.start(tmp_path / "node.log", "capture", str(write_node(folder, "window", 0)))
    try:
        # The same pictures, bit for bit, whatever the light.
        for weights in ((1.0, 1.0), (0.25, 0.0), (0.25, 0.5)):
            watcher.source.set_light_weights(weights)
            expected = local_words(weights)
            frame = watcher.frame(lambda f, e=expected: np.array_equal(watcher.words(f), e))  # type: ignore[misc]
        # Capture times on our clock: the other one is ahead by exactly a day.
        truth_ns = int(frame.metadata["node_ns"]) - CLOCK_OFFSET_S * 1_000_000_000
        error_ns = int(frame.metadata["node_clock_error_ns"])
        frame = watcher.frame(lambda f: f.timestamp_ns < time.monotonic_ns())
        assert error_ns < 1_000_000_000
        described = watcher.source.describe()
        assert described["joined"]
        assert described["node_source"] == "lab"
        clock = watcher.source._clock.offset(time.monotonic_ns())
        assert clock is not None
        assert abs(clock[0] + CLOCK_OFFSET_S * 1_000_000_000) <= clock[1]
        assert truth_ns <= time.monotonic_ns()
        node.said("joined", camera="cam")

        # The cable is pulled: noticed, said, and mended by itself.
        host.cut()
        assert "silent" in watcher.away()
        host.mend()
        watcher.frame()

        # The process is frozen, and thawed.
        (pid,) = node.camera_pids()
        host.run("/bin/kill", "-STOP", str(pid))
        assert any(words in watcher.away() for words in ("silent", "cut off"))
        host.run("/bin/kill", "-CONT", str(pid))
        watcher.frame()

        # It dies, and its parent starts it again: another session, the same picture.
        reconnects = watcher.source.describe()["reconnects"]
        host.run("/bin/kill", "-KILL", str(pid))
        watcher.frame(lambda f: watcher.source.describe()["reconnects"] > reconnects)
        assert np.array_equal(watcher.words(watcher.frame()), expected)
    finally:
        host.mend()
        node.close()
        watcher.source.close()


def test_smaller_pictures_and_wrong_sizes(
    folder: Path, room: RoomConfig, gate: int, host: OtherHost, tmp_path: Path
) -> None:
    watcher = Watcher(room, gate)
    node = host.start(tmp_path / "node.log", "capture", str(write_node(folder, "window", 0, reduce=2)))
    try:
        wait_until("a refusal", lambda: "room file must have the size" in watcher.away())
        assert watcher.source.describe()["frames_refused"] > 0
    finally:
        node.close()
        watcher.source.close()


def _heard(session: Any, key: str) -> list[bytes]:
    heard: list[bytes] = []
    session.declare_subscriber(key, lambda sample: heard.append(sample.payload.to_bytes()))
    return heard


def _until_heard(publish: Callable[[], None], heard: list[bytes]) -> None:
    def told() -> bool:
        publish()
        return bool(heard)

    wait_until("a message that is allowed", told)


def test_a_node_may_say_only_what_is_its_own(folder: Path, room: RoomConfig, gate: int) -> None:
    address = f"{SUBNET}.1:{PORT}"
    certificates = folder / "certificates"
    local = open_session(local_config(gate), "local")
    sessions = {
        node: open_session(node_config(address, CertificateFiles.in_folder(certificates, node)), node)
        for node in ("window", "door", "stranger")
    }
    try:
        prefix = remote_key(room.name, "window", "cam", "frame").partition("/remote/")[0]
        everything = _heard(local, f"{prefix}/remote/**")
        spied = _heard(sessions["door"], f"{prefix}/**")
        wishes = _heard(sessions["window"], remote_key(room.name, "window", "cam", "wish"))
        control = _heard(local, f"{prefix}/control/**")
        allowed = {
            "window": [remote_key(room.name, "window", "cam", "frame")],
            "door": [remote_key(room.name, "door", "cam", "answer")],
            "stranger": [],
        }
        forbidden = {
            "window": [
                remote_key(room.name, "door", "cam", "frame"),
                f"{prefix}/control/request",
                f"{prefix}/light/packet",
            ],
            "door": [
                remote_key(room.name, "window", "cam", "frame"),
                remote_key(room.name, "window", "cam", "answer"),
                f"{prefix}/control/state",
            ],
            "stranger": [
                remote_key(room.name, "window", "cam", "frame"),
                remote_key(room.name, "stranger", "cam", "frame"),
            ],
        }

        def publish() -> None:
            for node, keys in forbidden.items():
                for key in keys:
                    sessions[node].put(key, f"forbidden {node} {key}".encode())
            for node, keys in allowed.items():
                for key in keys:
                    sessions[node].put(key, f"allowed {node}".encode())
            local.put(remote_key(room.name, "window", "cam", "wish"), b"allowed wish")

        expected = {b"allowed window", b"allowed door"}
        wait_until("messages that are allowed", lambda: publish() or (expected <= set(everything) and wishes))
        publish()
        wait_until("more of them", lambda: everything.count(b"allowed door") > 1 and len(wishes) > 1)
        assert set(everything) - {b"allowed wish"} == expected
        assert set(wishes) == {b"allowed wish"}
        assert not control
        # It hears nothing of others; its own messages come back to it inside its own process.
        assert all(message.split()[1] == b"door" for message in spied)
    finally:
        for session in (*sessions.values(), local):
            session.close()


def test_who_has_no_valid_certificate_stays_outside(
    folder: Path, room: RoomConfig, gate: int, host: OtherHost, tmp_path: Path
) -> None:
    del gate
    address = f"{SUBNET}.1:{PORT}"
    ours = folder / "certificates"
    anonymous = node_config(address, CertificateFiles.in_folder(ours, "window"))
    for key in ("connect_certificate", "connect_private_key", "enable_mtls"):
        del anonymous["transport"]["link"]["tls"][key]
    with pytest.raises(BusError):
        open_session(anonymous, "anonymous")

    new_room(tmp_path / "other", [f"{SUBNET}.1"])
    new_node(tmp_path / "other", "window")
    stranger = CertificateFiles.in_folder(tmp_path / "other", "window")
    forged = CertificateFiles(authority=ours / "ca.pem", certificate=stranger.certificate, key=stranger.key)
    for files, words in ((stranger, "does not vouch for"), (forged, "refuses the certificate")):
        with pytest.raises(BusError):
            open_session(node_config(address, files), "of another room")
        assert words in why_no_connection(f"{SUBNET}.1", PORT, files)

    for name in ("ca.pem", "ca.key"):
        (tmp_path / name).write_bytes((ours / name).read_bytes())
    expired = new_node(tmp_path, "window", days=-0.001)  # type: ignore[arg-type]  # a minute and a half ago
    with pytest.raises(BusError):
        open_session(node_config(address, expired), "expired")
    assert "refuses the certificate" in why_no_connection(f"{SUBNET}.1", PORT, expired)

    # On the node the files are judged before anything is started.
    path = write_node(folder, "window", 0)
    path = path.rename(tmp_path / "window.toml")
    path.write_text(path.read_text().replace('"certificates"', '"."'), encoding="utf-8")
    node = host.start(tmp_path / "node.log", "capture", str(path))
    try:
        assert node.exit_code() == 2
        assert "window.pem expired on" in node.text()
    finally:
        node.close()


def test_hostile_frames_are_refused_in_words(folder: Path, room: RoomConfig, gate: int) -> None:
    watcher = Watcher(room, gate)
    files = CertificateFiles.in_folder(folder / "certificates", "window")
    link = RemoteLink(node_config(f"{SUBNET}.1:{PORT}", files), room.name, "window", "cam")
    stop = threading.Event()
    rng = np.random.default_rng(1)
    # The last one is larger than any frame of this camera: the gate does not even receive it whole.
    junk = [b"", b"NFR1" + bytes(200), rng.bytes(3000), bytes(2_000_000), b"[" * 5000]

    def attack() -> None:
        for turn in range(10_000):
            if stop.wait(0.02):
                return
            with_link = link
            try:
                with_link.put("frame", junk[turn % len(junk)])
                with_link.put("answer", junk[turn % len(junk)])
            except BusError:
                return

    attacker = threading.Thread(target=attack, daemon=True)
    attacker.start()
    try:
        wait_until("a refusal", lambda: "sends what cannot be used" in watcher.away())
        assert watcher.source.describe()["frames_refused"] > 0
    finally:
        stop.set()
        attacker.join()
        link.close()
        watcher.source.close()


def test_a_service_is_lit_by_another_machine_and_says_when_it_is_cut_off(
    folder: Path, host: OtherHost, tmp_path: Path
) -> None:
    service = Service(tmp_path / "service.log", room=folder)
    nodes: list[Process] = []
    try:
        for index, node in enumerate(("window", "door")):
            path = write_node(folder, node, index)
            nodes.append(host.start(tmp_path / f"{node}.log", "capture", str(path)))
        service.running()
        for camera in ("cam0", "cam1"):
            service.status(camera, connected=True, fault="")
        service.packet_after(time.monotonic())
        host.cut()
        for camera in ("cam0", "cam1"):
            fault = service.status(camera, connected=False)["fault"]
            assert any(words in fault for words in ("silent", "cut off"))
        service.status("illumination", stale=True)
        host.mend()
        for camera in ("cam0", "cam1"):
            service.status(camera, connected=True, fault="")
        service.status("illumination", stale=False)
        # The process through which they come in dies and is started again; so do the connections.
        failures = {camera: service.status(camera)["failures"] for camera in ("cam0", "cam1")}
        os.kill(service.pid("remote"), signal.SIGKILL)
        for camera, before in failures.items():
            service.wait("a failure", lambda c=camera, b=before: service.status(c)["failures"] > b)  # type: ignore[misc]
            service.status(camera, connected=True, fault="")
    finally:
        host.mend()
        for process in nodes:
            process.close()
        assert service.close() == 0
