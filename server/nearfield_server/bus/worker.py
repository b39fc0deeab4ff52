"""What every child process of the service does alike: specification in, life signs out, and an end when it should end."""

from __future__ import annotations

import ctypes
import dataclasses
import faulthandler
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NoReturn

import structlog

from nearfield_server.bus.keys import CONTROL_STATE, status_key
from nearfield_server.bus.messages import ControlState, status_json
from nearfield_server.bus.session import Bus
from nearfield_server.errors import BusError, NearfieldError, ServiceError

STATUS_PERIOD_S = 0.5
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerSpec:
    """What the supervisor tells a child, as JSON on its standard input.

    Attributes:
        process: name on the bus ("cam0", "illumination", "gateway").
        room_path: the room file or folder.
        room_name: prefix of the bus keys.
        bus_port: the supervisor's port on loopback.
        supervisor_pid: the expected parent.
        ring_fds: inherited frame rings by camera, in the order of the room file.
        signal_fd: inherited eventfd "frame ready".
        options: settings of this kind of process.
    """

    process: str
    room_path: str
    room_name: str
    bus_port: int
    supervisor_pid: int
    ring_fds: tuple[int, ...] = ()
    signal_fd: int = -1
    options: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> str:
        """Serialise to one line."""
        return json.dumps(dataclasses.asdict(self))

    @classmethod
    def from_json(cls, line: str) -> WorkerSpec:
        """Parse.

        Raises:
            ServiceError: not a specification of this release.
        """
        try:
            fields = json.loads(line)
            return cls(**{**fields, "ring_fds": tuple(fields["ring_fds"])})
        except (ValueError, TypeError, KeyError) as error:
            raise ServiceError(
                f"process specification on standard input is malformed ({error}); this process is started by the supervisor, not by hand"
            ) from error


def configure_logging(process: str) -> None:
    """Log to standard error: readable on a terminal, JSON lines otherwise; every line names the process."""
    renderer: Any = (
        structlog.dev.ConsoleRenderer() if sys.stderr.isatty() else structlog.processors.JSONRenderer()
    )
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso"),
            structlog.processors.format_exc_info,
            renderer,
        ],
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
    structlog.contextvars.clear_contextvars()
    structlog.contextvars.bind_contextvars(process=process)


def die_with_parent(parent_pid: int, death_signal: signal.Signals = signal.SIGKILL) -> None:
    """Ask the kernel for a signal to this process when the parent dies, however it dies.

    Raises:
        ServiceError: the parent is gone already.
    """
    # Set in the child itself: `preexec_fn` is not safe in a process that has threads.
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, int(death_signal), 0, 0, 0)
    if os.getppid() != parent_pid:
        raise ServiceError(f"process {os.getpid()}: the parent {parent_pid} is gone")


def set_on_signals(stop: threading.Event) -> None:
    """Set an event on SIGTERM and SIGINT; call it from the main thread."""

    def handle(*_: object) -> None:
        # Not set here: the handler may have interrupted the main thread inside `stop.wait()`, where it holds the lock of the event.
        threading.Thread(target=stop.set, name="stop", daemon=True).start()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, handle)


class Worker:
    """Life of a child process: bus, control state, heartbeat, stop signal.

    The main loop calls `beat()` at least every few seconds; a thread publishes the status with the age of the last beat, so that
    both a frozen process (no status) and a hung loop (old beat) are seen.
    """

    def __init__(self, spec: WorkerSpec) -> None:
        self.spec = spec
        self.stop = threading.Event()
        self.log = structlog.get_logger(f"nearfield.{spec.process}")
        self._lock = threading.Lock()
        self._control: ControlState | None = None
        self._control_changed = threading.Event()
        self._on_control: Callable[[], None] | None = None
        self._phase = "starting"
        self._beat = time.monotonic()
        self._status: dict[str, Any] = {}
        self._describe: Callable[[], dict[str, Any]] = dict
        self._started = time.monotonic()
        self._publisher = threading.Thread(target=self._publish_status, name="status", daemon=True)
        self.bus = Bus(spec.room_name, connect_port=spec.bus_port)

    def start(self) -> None:
        """Install signal handlers, announce the process, follow the control state."""
        set_on_signals(self.stop)
        self.bus.subscribe(CONTROL_STATE, lambda _, payload: self._take_control(payload))
        self.bus.announce(self.spec.process)
        self._publisher.start()

    def close(self) -> None:
        """Leave the bus."""
        self.stop.set()
        if self._publisher.is_alive():
            self._publisher.join(timeout=1.0)
        self.bus.close()

    def beat(self, phase: str = "running", **status: Any) -> None:
        """Say that the main loop is alive, and merge fields into the status."""
        with self._lock:
            self._beat = time.monotonic()
            self._phase = phase
            self._status.update(status)

    def describe(self, status: Callable[[], dict[str, Any]]) -> None:
        """Let `status()` add fields at the moment when a status is sent; it is called in another thread than the main loop's."""
        self._describe = status

    @property
    def control(self) -> ControlState | None:
        """The newest control state, or None before the first one."""
        with self._lock:
            return self._control

    def wait_for_control(self, timeout_s: float) -> ControlState:
        """Wait for the first control state.

        Raises:
            BusError: the supervisor did not answer in time.
        """
        end = time.monotonic() + timeout_s
        while time.monotonic() < end and not self.stop.is_set():
            state = self.control
            if state is not None:
                return state
            answer = self.bus.ask(CONTROL_STATE, timeout_s=0.5)
            if answer is not None:
                self._take_control(answer)
            else:
                self._control_changed.wait(0.05)
        raise BusError(f"{self.spec.process}: no control state from the supervisor within {timeout_s:.0f} s")

    def on_control(self, callback: Callable[[], None]) -> None:
        """Call `callback()` after each change of the control state (in a thread of the bus)."""
        self._on_control = callback

    def _take_control(self, payload: bytes) -> None:
        state = ControlState.from_json(payload)
        with self._lock:
            # The supervisor repeats the state for those who missed it.
            if self._control is not None and state.revision <= self._control.revision:
                return
            self._control = state
        self._control_changed.set()
        if self._on_control is not None:
            self._on_control()

    def status(self) -> dict[str, Any]:
        """Return the status as it is published."""
        described = self._describe()
        with self._lock:
            now = time.monotonic()
            return {
                "process": self.spec.process,
                "pid": os.getpid(),
                "phase": self._phase,
                "beat_age_s": round(now - self._beat, 3),
                "uptime_s": round(now - self._started, 3),
                **self._status,
                **described,
            }

    def _publish_status(self) -> None:
        key = status_key(self.spec.process)
        while not self.stop.wait(STATUS_PERIOD_S):
            try:
                self.bus.put(key, status_json(self.status()))
            except BusError as error:
                self.log.warning("status not sent", reason=str(error))


def run_worker(main: Callable[[Worker], None]) -> NoReturn:
    """Run a child process: read the specification, run `main(worker)`, turn deliberate errors into one logged line.

    It does not return after a requested stop (exit code 0) or a deliberate error (3): the process ends at once, because taking the
    interpreter apart with LLVM loaded costs more than a second. A process that is never given a specification ends quietly. Anything else
    propagates with its traceback: it is a bug.
    """
    faulthandler.enable()
    line = sys.stdin.readline()
    if not line:  # held in reserve, and never needed
        os._exit(0)
    spec = WorkerSpec.from_json(line)
    configure_logging(spec.process)
    code = _run(spec, main)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _run(spec: WorkerSpec, main: Callable[[Worker], None]) -> int:
    worker: Worker | None = None
    try:
        die_with_parent(spec.supervisor_pid)
        worker = Worker(spec)
        worker.start()
        main(worker)
    except NearfieldError as error:
        if worker is not None and worker.stop.is_set():
            return 0
        structlog.get_logger("nearfield.worker").error("process ends", reason=str(error))
        return 3
    finally:
        if worker is not None:
            worker.close()
    return 0
