"""The supervisor: owns rings and control state, starts the processes, keeps them alive, and ends them together."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from dataclasses import replace
from typing import Any

import structlog

from nearfield_protocol.codec import decode_client_message
from nearfield_protocol.errors import ProtocolError
from nearfield_server.bus.keys import CONTROL_REQUEST, CONTROL_STATE, RECORDING_FINISH, STATUS, status_key
from nearfield_server.bus.messages import parse_object, status_json
from nearfield_server.bus.session import Bus
from nearfield_server.bus.worker import WorkerSpec
from nearfield_server.capture.frame_signal import FrameSignal
from nearfield_server.capture.ring_memory import RingShape, create_ring
from nearfield_server.errors import BusError, ServiceError
from nearfield_server.gateway.listener import open_listener
from nearfield_server.scene.room_config import RoomConfig
from nearfield_server.supervisor.child import Child
from nearfield_server.supervisor.control import apply_request, initial_state, want_atlas
from nearfield_server.supervisor.control_socket import ControlSocket
from nearfield_server.supervisor.errand import Errands
from nearfield_server.supervisor.launcher import free_loopback_port
from nearfield_server.supervisor.notify import notify_systemd
from nearfield_server.supervisor.recorder_desk import RecorderDesk
from nearfield_server.supervisor.settings import ServiceSettings
from nearfield_server.supervisor.spare import Spare

PROCESS_NAME = "supervisor"
RECORDER_NAME = "recorder"
CAPTURE_MODULE = "nearfield_server.capture.process"
_TICK_S = 0.05
_PUBLISH_PERIOD_S = 0.5
_STOP_LIMIT_S = 2.0
_RECORDER_STOP_LIMIT_S = 4.0  # what waits for the disk is still written; the launcher waits for five seconds

_log = structlog.get_logger("nearfield.supervisor")


class Supervisor:
    """One running service. Use it from the main thread: `start()`, `run()` until `stop` is set, `close()`."""

    def __init__(self, settings: ServiceSettings, room: RoomConfig) -> None:
        """Acquire port, shared memory and bus; nothing is started yet.

        Raises:
            ServiceError, FrameRingError, BusError: something cannot be had; what was acquired is released again.
        """
        self.settings, self.room = settings, room
        self.stop = threading.Event()
        self.children: list[Child] = []
        self._lock = threading.Lock()
        self._state = initial_state(room)
        self._started_s = time.monotonic()
        self._published_s = 0.0
        self._ready = False
        self._errands: Errands[dict[str, Any]] = Errands()
        self._desk = RecorderDesk(self._make_recorder, self._finish_recorder)
        with contextlib.ExitStack() as undo:
            self._listener = undo.enter_context(open_listener(settings.host, settings.port))
            self._signal_fd = FrameSignal.create()
            undo.callback(os.close, self._signal_fd)
            self._ring_fds: list[int] = []
            for camera in room.cameras:
                shape = RingShape(camera.intrinsics.height, camera.intrinsics.width)
                self._ring_fds.append(create_ring(f"cam{len(self._ring_fds)}", shape))
                undo.callback(os.close, self._ring_fds[-1])
            self._spare = Spare(CAPTURE_MODULE, (*self._ring_fds, self._signal_fd))
            undo.callback(self._spare.close)
            self._gate_port = free_loopback_port() if room.remote_nodes else 0
            self.bus = undo.enter_context(Bus(room.name, listen_port=settings.bus_port))
            undo.enter_context(ControlSocket(self._command))
            self._resources = undo.pop_all()

    @property
    def _has_cameras(self) -> bool:
        return any(child.spare is not None for child in self.children)

    @property
    def port(self) -> int:
        """TCP port of the page."""
        port: int = self._listener.getsockname()[1]
        return port

    def start(self) -> None:
        """Start all processes.

        Raises:
            ServiceError: the system refuses a process.
        """
        self.bus.answer(CONTROL_STATE, lambda: self._state.to_json())
        self.bus.subscribe(CONTROL_REQUEST, lambda _, payload: self._request(payload))
        self.bus.subscribe(f"{STATUS}/*", self._take_status)
        self.bus.watch_alive(self._take_token)
        self.children = self._make_children()
        for child in self.children:
            child.start(time.monotonic())
        if self.settings.record is not None:
            # A supervisor that was killed and started again goes on with the recording.
            self._desk.start(self.settings.record, time.monotonic(), is_new=False)

    def run(self) -> None:
        """Watch until `stop` is set."""
        while not self.stop.wait(_TICK_S):
            now_s = time.monotonic()
            self._errands.run()
            with self._lock:
                for child in self.children:
                    child.watch(now_s)
                self._desk.watch(now_s)
                if self._ready and self._has_cameras:
                    self._spare.watch(now_s)
                all_running = all(
                    child.pid is not None and child.health.is_running(now_s) for child in self.children
                )
            if now_s - self._published_s >= _PUBLISH_PERIOD_S:
                self._published_s = now_s
                self._publish(now_s)
                if all_running and self._ready:
                    notify_systemd("WATCHDOG=1")
            if all_running and not self._ready:
                self._ready = True
                self._spare.wait(now_s)
                with self._lock:
                    state = replace(
                        self._state, revision=self._state.revision + 1, started_ns=time.monotonic_ns()
                    )
                    self._state = state
                self.bus.put(CONTROL_STATE, state.to_json(), must_arrive=True)
                notify_systemd("READY=1")
                _log.info("service ready", seconds=round(now_s - self._started_s, 2), port=self.port)

    def close(self) -> None:
        """End all processes within two seconds, then give everything back."""
        notify_systemd("STOPPING=1")
        for child in self._all_children():
            child.terminate()
        now_s = time.monotonic()
        for child in self.children:
            child.finish(now_s + _STOP_LIMIT_S - time.monotonic())
        if self._desk.child is not None:
            self._desk.child.finish(now_s + _RECORDER_STOP_LIMIT_S - time.monotonic())
        self._resources.close()

    def _make_children(self) -> list[Child]:
        rings = tuple(self._ring_fds)
        settings = self.settings
        replay = settings.replay or {}
        # In lockstep the player takes the frames from the recording itself, one update after the other.
        is_lockstep = bool(replay.get("lockstep"))
        children = []
        if self._gate_port:
            gate = {"gate_port": self._gate_port}
            children.append(Child(self._spec("remote", gate), "nearfield_server.capture.remote.gate"))
        for index in range(0 if is_lockstep else len(self.room.cameras)):
            options = {
                "camera_index": index,
                "frame_rate": settings.frame_rate,
                "timeline": settings.timeline,
                "sensor": settings.sensor,
                "gate_port": self._gate_port,
                "replay": {name: replay[name] for name in ("speed", "loop") if name in replay},
            }
            # A capture process inherits its own ring alone (the one in reserve: all); the other descriptors are only numbers to it.
            fds = (rings[index], self._signal_fd)
            children.append(Child(self._spec(f"cam{index}", options), CAPTURE_MODULE, fds, spare=self._spare))
        light: dict[str, Any] = {
            "frame_rate": settings.frame_rate,
            "num_vals": settings.num_vals,
            "split_ratio": settings.split_ratio,
            "backend": settings.backend,
        }
        light_module = "nearfield_server.illumination.process"
        if is_lockstep:
            light |= {"recording": settings.room_path, "loop": replay.get("loop", True)}
            light_module = "nearfield_server.recording.player"
        children.append(Child(self._spec("illumination", light), light_module, (*rings, self._signal_fd)))
        gateway = {
            **settings.gateway,
            "host": settings.host,
            "port": self.port,
            "listen_fd": self._listener.fileno(),
            "num_vals": settings.num_vals,
        }
        children.append(
            Child(
                self._spec("gateway", gateway), "nearfield_server.gateway.process", (self._listener.fileno(),)
            )
        )
        return children

    def _all_children(self) -> list[Child]:
        """The processes of the service, and the recorder while there is one."""
        return [*self.children, *([] if self._desk.child is None else [self._desk.child])]

    def _make_recorder(self, options: dict[str, Any]) -> Child:
        settings = self.settings
        light = {
            "frame_rate": settings.frame_rate,
            "num_vals": settings.num_vals,
            "split_ratio": settings.split_ratio,
        }
        spec = self._spec(RECORDER_NAME, {**light, **options})
        return Child(spec, "nearfield_server.recording.process", tuple(self._ring_fds))

    def _finish_recorder(self) -> None:
        self.bus.put(RECORDING_FINISH, b"{}", must_arrive=True)

    def _command(self, request: dict[str, Any]) -> dict[str, Any]:
        """Answer a command of the user's command line; called in the thread of the control socket."""
        command = request.get("command")
        if command == "record":
            known = ("folder", "kind", "reserve_bytes", "queue_bytes")
            options: dict[str, Any] = {name: request[name] for name in known if name in request}
            return self._errands.request(lambda: self._record(options))
        if command == "finish":
            return self._errands.request(self._finish_record)
        if command == "status":
            return self._errands.request(self._describe)
        raise ServiceError(f"command {str(command)[:40]!r} is not known; expected record, finish or status")

    def _record(self, options: dict[str, Any]) -> dict[str, Any]:
        with self._lock:
            self._desk.start(options, time.monotonic())
        return self._describe()

    def _finish_record(self) -> dict[str, Any]:
        self._desk.finish(time.monotonic())
        return self._describe()

    def _describe(self) -> dict[str, Any]:
        return {
            "pid": os.getpid(),
            "room": self.room.name,
            "room_path": self.settings.room_path,
            "port": self.port,
            "ready": self._ready,
            "frame_rate": self.settings.frame_rate or self.room.frame_rate,
            **self._desk.report(),
        }

    def _spec(self, process: str, options: dict[str, Any]) -> WorkerSpec:
        return WorkerSpec(
            process=process,
            room_path=self.settings.room_path,
            room_name=self.room.name,
            bus_port=self.settings.bus_port,
            supervisor_pid=os.getpid(),
            ring_fds=tuple(self._ring_fds),
            signal_fd=self._signal_fd,
            options=options,
        )

    def _request(self, payload: bytes) -> None:
        try:
            message = decode_client_message(payload)
            with self._lock:
                state = apply_request(self._state, message)
                changed = state is not self._state
                self._state = state
        except (ProtocolError, BusError) as error:
            _log.warning("control request refused", reason=str(error))
            return
        if changed:
            self.bus.put(CONTROL_STATE, state.to_json(), must_arrive=True)

    def _take_status(self, _key: str, payload: bytes) -> None:
        status = parse_object(payload, STATUS)
        with self._lock:
            for child in self._all_children():
                is_heard = child.hear(status, time.monotonic())
                if is_heard and child.name == "gateway" and "atlas_wanted" in status:
                    self._state = want_atlas(self._state, bool(status["atlas_wanted"]))

    def _take_token(self, process: str, is_alive: bool) -> None:
        with self._lock:
            for child in self._all_children():
                if child.name == process:
                    child.health.token(is_alive)

    def _publish(self, now_s: float) -> None:
        status = {
            "process": PROCESS_NAME,
            "pid": os.getpid(),
            "phase": "running" if self._ready else "starting",
            "uptime_s": round(now_s - self._started_s, 3),
            "port": self.port,
            "spare_pid": self._spare.pid,
            "children": {
                child.name: {**child.report(), "fault": child.health.fault(now_s)}
                for child in self._all_children()
            },
        }
        with contextlib.suppress(BusError):
            self.bus.put(status_key(PROCESS_NAME), status_json(status))
            # Repeated for those who missed it: a process that has just connected hears only what comes afterwards.
            self.bus.put(CONTROL_STATE, self._state.to_json())
