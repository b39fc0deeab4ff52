"""A camera node's side of the connection: a thread that sends the newest frame of a ring, and never holds up the camera."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from typing import Any

import structlog

from nearfield_server.capture.frame_ring import FrameRingReader
from nearfield_server.capture.frame_signal import FrameSignal
from nearfield_server.capture.remote.certificates import CertificateFiles, why_no_connection
from nearfield_server.capture.remote.frame_sender import FrameSender
from nearfield_server.capture.remote.links import RemoteLink, node_config
from nearfield_server.capture.remote.messages import Answer, FrameEncoder, Wish
from nearfield_server.errors import BusError, CaptureError
from nearfield_server.scene.node_config import NodeCamera, NodeConfig

_JOINED_LIMIT_S = 2.5
_RETRY_S = 0.5
_CONFIRMED_POLL_S = 0.025
_DIAGNOSIS_PERIOD_S = 5.0
_log = structlog.get_logger("nearfield.node")


class NodeLink:
    """Sends one camera's frames while the service asks for them.

    Args:
        node: the node file. camera: which of its cameras.
        files: the node's certificate.
        ring: that the camera is captured into.
        signal: rung for each new frame.
        describe: returns (what is wrong with the camera or "", how it describes itself).
    """

    def __init__(
        self,
        node: NodeConfig,
        camera: NodeCamera,
        files: CertificateFiles,
        ring: FrameRingReader,
        signal: FrameSignal,
        describe: Callable[[], tuple[str, dict[str, Any]]],
    ) -> None:
        self._node, self._camera, self._files = node, camera, files
        self._ring, self._signal, self._describe = ring, signal, describe
        self._period_s = 1.0 / camera.max_rate
        # Where the camera itself keeps the rate, sending must be a little faster: what was held up once would stay late for ever.
        self._interval_s = self._period_s * (1.0 if camera.max_rate < node.frame_rate else 0.8)
        self._sender = FrameSender(
            session=secrets.randbits(63) | 1,
            encoder=FrameEncoder(camera.compression),
            period_us=round(1e6 * self._period_s),
            tiles_only=camera.tiles,
        )
        self._lock = threading.Lock()
        self._wish: Wish | None = None
        self._wish_s = float("-inf")
        self._link: RemoteLink | None = None
        self._reason = "not joined yet"
        self._was_joined = False
        self._diagnosed_s = float("-inf")
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)

    def start(self) -> None:
        """Begin to join, for as long as it takes."""
        self._thread.start()

    def close(self) -> None:
        """Leave."""
        self._stop.set()
        self._thread.join(timeout=2.0)
        if self._link is not None:
            self._link.close()

    @property
    def light_weights(self) -> tuple[float, ...] | None:
        """Newest weights of simulated lights that the service told; None before."""
        with self._lock:
            return None if self._wish is None else self._wish.light_weights

    @property
    def is_joined(self) -> bool:
        """Whether the service has asked for frames lately."""
        with self._lock:
            return time.monotonic() - self._wish_s < _JOINED_LIMIT_S

    def status(self) -> dict[str, Any]:
        """Numbers for the status of the node."""
        sender = self._sender
        joined = self.is_joined
        return {
            "joined": joined,
            "service": self._node.address,
            "reason": "" if joined else self._reason,
            "frames_sent": sender.frames,
            "frames_confirmed": sender.confirmations,
            "bytes_sent": sender.bytes_sent,
            "tiles_sent": sender.tiles_sent,
        }

    def _run(self) -> None:
        next_s = 0.0
        while not self._stop.is_set():
            if self._link is None and not self._open():
                self._stop.wait(_RETRY_S)
                continue
            self._tell_changes()
            # New pictures ring; that an old one still holds is only to be seen in the ring.
            self._signal.wait(min(self._period_s, _CONFIRMED_POLL_S))
            if not self.is_joined:
                continue
            now_s = time.monotonic()
            if now_s < next_s:  # more frames than `max_rate`: the next message holds them all
                self._stop.wait(next_s - now_s)
            if self._send():
                # A frame that comes a little early is not held up: one interval may be saved, no more.
                next_s = max(next_s, time.monotonic() - self._interval_s) + self._interval_s

    def _send(self) -> bool:
        """Send the newest frame, if there is news; true if there was."""
        view = self._ring.newest()
        if view is None or self._link is None:
            return False
        with self._lock:
            message = self._sender.next_message(view, time.monotonic_ns())
        if message is None:
            return False
        try:
            self._link.put("frame", message)
        except BusError as error:
            _log.warning("frame not sent", reason=str(error))
        return True

    def _open(self) -> bool:
        node, camera = self._node, self._camera
        try:
            link = RemoteLink(node_config(node.address, self._files), node.room, node.node, camera.camera_id)
        except BusError as error:
            self._diagnose(str(error))
            return False
        self._link = link
        link.subscribe("wish", lambda payload: self._take_wish(payload.to_bytes(), time.monotonic_ns()))
        link.announce()
        # The service asks for frames within a second; before that there is nothing to explain.
        self._diagnosed_s = time.monotonic() - _DIAGNOSIS_PERIOD_S + 1.5
        return True

    def _take_wish(self, message: bytes, received_ns: int) -> None:
        try:
            wish = Wish.from_json(message)
        except CaptureError as error:
            _log.warning("message of the service refused", reason=str(error))
            return
        with self._lock:
            self._wish, self._wish_s = wish, time.monotonic()
            self._sender.acknowledge(wish)
        fault, source = self._describe()
        answer = Answer(
            asked_ns=wish.asked_ns,
            received_ns=received_ns,
            answered_ns=time.monotonic_ns(),
            fault=fault,
            source=source,
        )
        if self._link is not None:
            self._link.put("answer", answer.to_json())

    def _tell_changes(self) -> None:
        joined = self.is_joined
        if joined and not self._was_joined:
            _log.info("joined", camera=self._camera.camera_id, service=self._node.address)
        if not joined:
            if self._was_joined:
                _log.warning("cut off", camera=self._camera.camera_id, service=self._node.address)
            self._diagnose("")
        self._was_joined = joined

    def _diagnose(self, found: str) -> None:
        """Find out why the service does not answer, now and then, and log it when it is something new."""
        now_s = time.monotonic()
        if now_s - self._diagnosed_s < _DIAGNOSIS_PERIOD_S:
            return
        self._diagnosed_s = now_s
        host, _, port = self._node.address.rpartition(":")
        reason = why_no_connection(host.strip("[]"), int(port), self._files)
        if not reason and found:
            reason = f"TLS works, but the bus refuses: {found}"
        if not reason:
            reason = (
                f"connected to {self._node.address}, but the service does not ask for camera '{self._camera.camera_id}' of node "
                f"'{self._node.node}' in room '{self._node.room}': do these names stand in its room file?"
            )
        if reason != self._reason:
            self._reason = reason
            _log.warning("not joined", camera=self._camera.camera_id, reason=reason)
