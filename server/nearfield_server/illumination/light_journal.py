"""Tells a recorder, over the bus, what every update of the light was made of and which packet came of it."""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from typing import Any, Protocol

from nearfield_server.bus.keys import LIGHT_LOG, LIGHT_LOG_BEGIN, LIGHT_LOG_END
from nearfield_server.illumination.packet import PacketWriter
from nearfield_server.recording.files.light_log import LightBegin, LightStep
from nearfield_server.records import CameraFrame, ObjectPlacement, ObjectPose

RECORDER = "recorder"
"""Name of the recorder process on the bus."""


class JournalBus(Protocol):
    """The part of the message bus that the journal uses."""

    def put(self, key: str, payload: bytes, *, must_arrive: bool = False) -> None:
        """Send."""

    def answer(self, key: str, reply: Any) -> None:
        """Answer questions."""

    def subscribe(self, key: str, callback: Any) -> None:
        """Receive."""

    def watch_alive(self, callback: Any) -> None:
        """Hear of processes that come and go."""


class LightJournal:
    """One per illumination process. A recorder asks for a run and gets its number; the run begins with the next update."""

    def __init__(self, bus: JournalBus) -> None:
        self._bus = bus
        self._lock = threading.Lock()
        self._asked = 0
        self._begun = 0
        self._is_on = False
        self._number = 0
        self._key: Any = None
        self._poses: list[int] | None = None
        self._packet = b""
        bus.answer(LIGHT_LOG_BEGIN, self._answer)
        bus.subscribe(LIGHT_LOG_END, lambda *_: self.end())
        bus.watch_alive(lambda process, is_alive: None if is_alive or process != RECORDER else self.end())

    @property
    def is_on(self) -> bool:
        """Whether a recorder listens."""
        with self._lock:
            return self._is_on

    def take_request(self) -> int | None:
        """Number of the run that a recorder has asked for since the last call, if any."""
        with self._lock:
            if self._asked == self._begun:
                return None
            self._begun = self._asked
            return self._begun

    def begin(self, run: int, writer: PacketWriter, backend: str) -> None:
        """Begin a run: the pipeline has just been made.

        Args:
            run: from `take_request`.
            writer: that numbers the packets from now on.
            backend: what the stages run on.
        """
        with self._lock:
            self._is_on = True
        self._number, self._key, self._poses, self._packet = 0, None, None, b""
        self._send(
            LightBegin(
                run=run,
                first_sequence=writer.sequence,
                backend=backend,
                room_revision=writer.room_revision,
            ).to_fields()
        )

    def note(self, frames: Sequence[CameraFrame | None], poses: Sequence[ObjectPose], packet: bytes) -> None:
        """Tell of an update, unless it was one of nothing new."""
        if not self.is_on:
            return
        sequences = tuple(None if frame is None else frame.sequence for frame in frames)
        revisions = [pose.revision for pose in poses]
        if (sequences, revisions) == self._key and packet == self._packet:
            return
        self._number += 1
        objects = tuple(
            ObjectPlacement(revision=pose.revision, world_from_object=pose.world_from_object)
            for pose in poses
        )
        step = LightStep(
            run=self._begun,
            number=self._number,
            frames=sequences,
            objects=None if revisions == self._poses else objects,
            packet=None if packet == self._packet else packet,
        )
        self._key, self._poses, self._packet = (sequences, revisions), revisions, packet
        self._send(step.to_fields())

    def end(self) -> None:
        """Nobody listens any more."""
        with self._lock:
            self._is_on = False

    def _answer(self) -> bytes:
        with self._lock:
            self._asked += 1
            return json.dumps({"run": self._asked}).encode()

    def _send(self, fields: dict[str, Any]) -> None:
        self._bus.put(LIGHT_LOG, json.dumps(fields, separators=(",", ":")).encode(), must_arrive=True)
