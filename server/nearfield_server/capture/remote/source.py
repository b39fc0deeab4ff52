"""A camera of another machine as a `Source`: it runs in the camera's own capture process, like any other."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nearfield_server.capture.frame_metadata import parse_metadata
from nearfield_server.capture.frame_stream import silence_limit_s
from nearfield_server.capture.remote.clock_exchange import ClockExchange
from nearfield_server.capture.remote.links import RemoteLink, local_config
from nearfield_server.capture.remote.messages import Answer, FrameHeader, Wish, largest_frame_bytes
from nearfield_server.capture.remote.picture import RemotePicture
from nearfield_server.capture.source import RawFrame
from nearfield_server.errors import AwayError, BusError, CaptureError

_WISH_PERIOD_S = 0.25
_FIRST_WISH_PERIOD_S = 0.05
_ANSWERS_ON_S = 0.15
_WAIT_S = 0.1
_LEAST_PERIODS = 2.5
# What is passed on to the status page of the fields with which the camera describes itself on its node.
_PASSED_ON = (
    "model",
    "serial",
    "address",
    "path",
    "pixel_format",
    "exposure_s",
    "gain",
    "saturated_share",
    "temperature_c",
    "clock_skew_ppm",
)
_MAX_WARNINGS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoteCamera:
    """Which camera of which machine.

    Attributes:
        camera_id: name in this room.
        room: name of the room.
        node: name of the machine.
        camera: name of the camera there.
        height: pixels that arrive. width: pixels that arrive.
        frame_rate: expected until the first frame says what the node aims at.
        gate_port: port of the gate on loopback.
    """

    camera_id: str
    room: str
    node: str
    camera: str
    height: int
    width: int
    frame_rate: float
    gate_port: int


class RemoteSource:
    """Takes the newest frame that has come, acknowledges it, keeps the clocks related, and says in words why none comes.

    Frames that come faster than they are taken are left out: the next one holds what they held.

    Args:
        camera: which one.
        clock_ns: CLOCK_MONOTONIC, replaced in tests.
    """

    def __init__(self, camera: RemoteCamera, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.camera = camera
        self._clock_ns = clock_ns
        self._picture = RemotePicture(camera.height, camera.width)
        self._clock = ClockExchange()
        self._lock = threading.Lock()
        self._something = threading.Event()
        self._link: RemoteLink | None = None
        self._newest: Any = None
        self._answer: Answer | None = None
        self._answer_heard_ns = 0
        self._is_there = False
        self._weights: tuple[float, ...] | None = None
        self._wished_ns = 0
        self._confirmed_ns = 0
        self._period_s = 1.0 / camera.frame_rate
        self._fresh_ns: int | None = None
        self._watch_from_ns = 0
        self._refused, self._replaced, self._taken, self._bytes = 0, 0, 0, 0
        self._refusal = ""

    def open(self) -> None:
        """Join the gate of this machine.

        Raises:
            AwayError: the gate does not run.
        """
        camera = self.camera
        try:
            link = RemoteLink(local_config(camera.gate_port), camera.room, camera.node, camera.camera)
        except BusError as error:
            raise AwayError(
                f"camera {camera.camera_id}: the process `remote`, through which camera nodes join, does not run yet ({error})"
            ) from error
        with self._lock:
            self._newest, self._answer, self._is_there = None, None, False
        self._link = link
        self._refusal = ""
        self._watch_from_ns, self._wished_ns = self._clock_ns(), 0
        link.subscribe("frame", self._take_frame)
        link.subscribe("answer", lambda payload: self._take_answer(payload.to_bytes(), self._clock_ns()))
        link.watch_alive(self._take_alive)

    def close(self) -> None:
        """Leave the gate."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def set_light_weights(self, weights: tuple[float, ...]) -> None:
        """Pass the weights on: the node may have simulated cameras."""
        if weights != self._weights:
            self._weights = weights
            self._wished_ns = 0

    def wait_for_frame(self, stop: threading.Event, period_s: float) -> None:
        """Wait for a frame, a tenth of a second at most."""
        self._send_wish_if_due()
        if not stop.is_set():
            self._something.wait(_WAIT_S if self._answer is not None else _FIRST_WISH_PERIOD_S)

    def next_frame(self, now_ns: int) -> RawFrame | None:
        """Return the newest frame that came, its capture time on this machine's clock; None if there is none.

        Raises:
            AwayError: nothing has come for too long; says whether the node never joined, was cut off, or is silent.
        """
        if self._link is None:
            raise CaptureError(f"camera {self.camera.camera_id}: next_frame before open")
        with self._lock:
            self._something.clear()
            payload, self._newest = self._newest, None
        frame = None if payload is None else self._frame(payload, now_ns)
        self._check_silence(now_ns)
        self._send_wish_if_due()
        return frame

    def _frame(self, payload: Any, now_ns: int) -> RawFrame | None:
        session = self._picture.session
        try:
            header = self._take(payload)
        except CaptureError as error:
            self._refused += 1
            self._refusal = str(error)
            return None
        self._wished_ns = 0  # acknowledges, or asks for what is missing
        if header is None:
            return None
        if header.session != session:
            self._clock.clear()  # the node has restarted, perhaps its machine too
            self._confirmed_ns = 0
        offset = self._clock.offset(now_ns)
        if offset is None:  # for a moment only, unless the node never answers
            self._refusal = "frames, but no answers to questions about its clock"
            return None
        self._refusal = ""
        if header.confirmed_ns > self._confirmed_ns:
            self._confirmed_ns, self._fresh_ns = header.confirmed_ns, now_ns
        self._period_s = min(max(header.period_us * 1e-6, 1e-3), 2.0)
        self._taken += 1
        is_new = header.base != header.revision
        captured_ns = header.timestamp_ns if is_new else header.confirmed_ns
        return RawFrame(
            pixels=self._picture.pixels,
            # Never from the future: age is counted from here.
            timestamp_ns=min(now_ns, captured_ns + offset[0]),
            content_revision=self._picture.content_revision,
            metadata={
                **parse_metadata(header.metadata),
                "node": self.camera.node,
                "node_ns": str(header.timestamp_ns),
                "node_clock_error_ns": str(offset[1]),
            },
        )

    def _take(self, payload: Any) -> FrameHeader | None:
        limit = largest_frame_bytes(self.camera.height, self.camera.width)
        if len(payload) > limit:
            raise CaptureError(f"frame of {len(payload)} bytes, expected at most {limit}")
        message = payload.to_bytes()
        self._bytes += len(message)
        return self._picture.take(message)

    def _check_silence(self, now_ns: int) -> None:
        since_ns = max(self._watch_from_ns, self._fresh_ns or 0)
        silent_s = (now_ns - since_ns) * 1e-9
        if silent_s > silence_limit_s(self._period_s, least_periods=_LEAST_PERIODS):
            raise AwayError(self.why_silent(now_ns))

    def why_silent(self, now_ns: int) -> str:
        """Say in words why no frame comes."""
        camera = self.camera
        name = f"camera {camera.camera_id}: node {camera.node}"
        with self._lock:
            is_there, answer = self._is_there, self._answer
            # Its answers go on although its frames have stopped, or never began.
            since_s = (self._answer_heard_ns - max(self._fresh_ns or 0, self._watch_from_ns)) * 1e-9
            answers = answer is not None and since_s > _ANSWERS_ON_S
        if self._refusal:
            return f"{name} sends what cannot be used: {self._refusal}"
        if not is_there and self._fresh_ns is None:
            return (
                f"{name} has never joined with a camera '{camera.camera}'. Start `nearfield capture` there; "
                "it says what keeps it from joining"
            )
        if not is_there:
            return f"{name} is cut off or has ended; it joins again by itself"
        if answer is not None and answers:
            return f"{name}: {answer.fault or f'answers, but its camera {camera.camera} delivers no frames'}"
        return f"{name} is silent (frozen, or just cut off); it joins again by itself"

    def _send_wish_if_due(self) -> None:
        now_ns = self._clock_ns()
        period_s = _WISH_PERIOD_S if self._answer is not None else _FIRST_WISH_PERIOD_S
        if self._link is None or (now_ns - self._wished_ns) * 1e-9 < period_s:
            return
        self._wished_ns = now_ns
        wish = Wish(
            session=self._picture.session,
            revision=self._picture.revision,
            asked_ns=self._clock_ns(),
            light_weights=self._weights,
        )
        with contextlib.suppress(BusError):  # closed under our hands: the watch on silence says so
            self._link.put("wish", wish.to_json())

    def _take_frame(self, payload: Any) -> None:
        with self._lock:
            self._replaced += self._newest is not None
            self._newest = payload
        self._something.set()

    def _take_answer(self, message: bytes, heard_ns: int) -> None:
        try:
            answer = Answer.from_json(message)
        except CaptureError as error:
            self._refused += 1
            self._refusal = str(error)
            return
        with self._lock:
            if self._clock.add(answer.asked_ns, answer.received_ns, answer.answered_ns, heard_ns):
                self._answer, self._answer_heard_ns = answer, heard_ns

    def _take_alive(self, is_there: bool) -> None:
        with self._lock:
            if is_there and not self._is_there:
                self._watch_from_ns = self._clock_ns()  # its camera may take a moment to open
            self._is_there = is_there
        self._something.set()

    def describe(self) -> dict[str, Any]:
        """Describe the camera for the status page."""
        with self._lock:
            answer, offset = self._answer, self._clock.offset(self._clock_ns())
            is_there, replaced = self._is_there, self._replaced
        source = answer.source if answer is not None else {}
        described = {key: _plain(source[key]) for key in _PASSED_ON if key in source}
        warnings = source.get("warnings", [])
        words = [f"node {self.camera.node}: {str(w)[:300]}" for w in _as_list(warnings)[:_MAX_WARNINGS]]
        if self._clock.restarts:
            words.append(
                f"the clock of node {self.camera.node} jumped {self._clock.restarts} times (did it sleep?)"
            )
        return {
            **described,
            "kind": "remote",
            "node": self.camera.node,
            "camera": self.camera.camera,
            "joined": is_there,
            "node_source": str(source.get("kind", ""))[:40],
            "frames_taken": self._taken,
            "frames_replaced": replaced,
            "frames_lost": self._picture.missed + _count(source.get("frames_lost")),
            "frames_broken": self._refused + _count(source.get("frames_broken")),
            "frames_refused": self._refused,
            "bytes_received": self._bytes,
            "clock_error_ms": -1.0 if offset is None else round(offset[1] * 1e-6, 3),
            "reconnects": max(0, self._picture.sessions - 1),
            "warnings": words,
        }


def _as_list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _count(value: Any) -> int:
    """A count of the node; 0 where it tells none."""
    return value if isinstance(value, int) and not isinstance(value, bool) and value > 0 else 0


def _plain(value: Any) -> Any:
    """A number, a short text, or a short list of them: what another machine says must not blow up the page."""
    if isinstance(value, list):
        return [_plain(entry) for entry in value[:16] if not isinstance(entry, list)]
    return value if isinstance(value, bool | int | float) else str(value)[:100]
