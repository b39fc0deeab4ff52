"""A camera node: starts one process per camera of this machine, keeps them alive, and ends them together."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from pathlib import Path

import structlog

from nearfield_server.bus.keys import STATUS
from nearfield_server.bus.messages import parse_object
from nearfield_server.bus.session import Bus
from nearfield_server.bus.worker import WorkerSpec, configure_logging, set_on_signals
from nearfield_server.capture.remote.certificates import CertificateFiles, check_files
from nearfield_server.scene.node_config import NodeConfig, load_node
from nearfield_server.supervisor.child import Child
from nearfield_server.supervisor.launcher import free_loopback_port

PROCESS_NAME = "node"
_TICK_S = 0.05
_STOP_LIMIT_S = 2.0
_log = structlog.get_logger("nearfield.node")


class CameraNode:
    """The cameras of one machine, each in a process of its own. Use it from the main thread.

    Its bus is on loopback and tells only how the processes are; frames leave each process by a connection of its own.

    Args:
        path: the node file.
        node: what it says.
        sensor: fields of `SensorModel` for simulated cameras.

    Raises:
        BusError: the bus cannot be opened.
    """

    def __init__(self, path: Path, node: NodeConfig, sensor: dict[str, float] | None = None) -> None:
        self.stop = threading.Event()
        self._lock = threading.Lock()
        port = free_loopback_port()
        self.bus = Bus(node.room, listen_port=port)
        self.children = [
            Child(
                WorkerSpec(
                    process=f"cam{index}",
                    room_path=str(path.resolve()),
                    room_name=node.room,
                    bus_port=port,
                    supervisor_pid=os.getpid(),
                    options={"camera_index": index, "sensor": sensor},
                ),
                "nearfield_server.capture.remote.node_camera",
            )
            for index in range(len(node.cameras))
        ]

    def run(self) -> None:
        """Start the processes and watch them until `stop` is set."""
        self.bus.subscribe(f"{STATUS}/*", self._take_status)
        self.bus.watch_alive(self._take_token)
        for child in self.children:
            child.start(time.monotonic())
        while not self.stop.wait(_TICK_S):
            with self._lock:
                for child in self.children:
                    child.watch(time.monotonic())

    def close(self) -> None:
        """End all processes within two seconds."""
        for child in self.children:
            child.terminate()
        end_s = time.monotonic() + _STOP_LIMIT_S
        for child in self.children:
            child.finish(end_s - time.monotonic())
        self.bus.close()

    def _take_status(self, _key: str, payload: bytes) -> None:
        status = parse_object(payload, STATUS)
        with self._lock:
            for child in self.children:
                child.hear(status, time.monotonic())

    def _take_token(self, process: str, is_alive: bool) -> None:
        with self._lock:
            for child in self.children:
                if child.name == process:
                    child.health.token(is_alive)


def run_node(path: Path, sensor: dict[str, float] | None = None) -> int:
    """Run a camera node in the foreground until a signal ends it.

    Args:
        path: the node file.
        sensor: fields of `SensorModel` for simulated cameras.

    Returns:
        The exit code.

    Raises:
        ConfigError, AssetError: the node file or a certificate is wrong.
        BusError, ServiceError: it cannot run.
    """
    node = load_node(path)
    warnings = check_files(CertificateFiles.in_folder(node.certificates, node.node), common_name=node.node)
    configure_logging(PROCESS_NAME)
    for warning in warnings:
        _log.warning("certificate", reason=warning)
    with contextlib.closing(CameraNode(path, node, sensor)) as cameras:
        set_on_signals(cameras.stop)
        cameras.run()
    return 0
