"""Hears from the illumination process what every update was made of, and asks it to begin whenever the thread is lost."""

from __future__ import annotations

import queue
import threading
import time
from typing import Any, Final

from nearfield_server.bus.keys import LIGHT_LOG, LIGHT_LOG_BEGIN, LIGHT_LOG_END
from nearfield_server.bus.messages import parse_object
from nearfield_server.bus.session import Bus
from nearfield_server.errors import BusError

ILLUMINATION: Final = "illumination"
_ASK_AGAIN_S: Final = 15.0
_BEGIN_PERIOD_S: Final = 30.0
"""Least time between two begins for lost frames: each one costs the light half a second."""
_PAUSE_S: Final = 0.05


class LightLink:
    """One per recorder. Lines wait in `lines` until the recorder takes them; the bus is never held up.

    The answer to "begin" comes over the same connection as the subscription went, so that a run that was promised is heard from its
    first line. Should a line be missing all the same, another run is asked for.
    """

    def __init__(self, bus: Bus) -> None:
        self.lines: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._bus = bus
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._is_wanted = True
        self._begun_s = time.monotonic()
        self._run = self._number = -1
        bus.subscribe(LIGHT_LOG, self._take)
        bus.watch_alive(self._alive)
        self._thread = threading.Thread(target=self._ask, name="light-link", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Tell the illumination process that nobody listens."""
        self._stop.set()
        self._thread.join(timeout=2.0)
        self._bus.put(LIGHT_LOG_END, b"{}", must_arrive=True)

    def begin_again(self) -> bool:
        """A frame that the light used is lost: let another run begin, which can be followed again; false if the last begin is too young."""
        with self._lock:
            if time.monotonic() - self._begun_s < _BEGIN_PERIOD_S:
                return False
            self._begun_s = time.monotonic()
            self._is_wanted = True
            return True

    def _take(self, _key: str, payload: bytes) -> None:
        fields = parse_object(payload, LIGHT_LOG)
        with self._lock:
            if fields.get("kind") == "begin":
                self._run, self._number = fields.get("run", -1), 0
                self._begun_s = time.monotonic()
            elif fields.get("run") != self._run or fields.get("number") != self._number + 1:
                # Out of the middle of a run: nothing can be made of it.
                self._is_wanted = self._is_wanted or fields.get("run") == self._run
                self._run = -1
                return
            else:
                self._number += 1
        self.lines.put(fields)

    def _alive(self, process: str, is_alive: bool) -> None:
        if process == ILLUMINATION and is_alive:
            with self._lock:
                self._is_wanted = True

    def _ask(self) -> None:
        promised, asked_s = False, 0.0
        while not self._stop.wait(_PAUSE_S):
            with self._lock:
                wanted = self._is_wanted
                # Promised, but nothing has come.
                wanted |= promised and self._run < 0 and time.monotonic() - asked_s > _ASK_AGAIN_S
                self._is_wanted = False
            if not wanted:
                continue
            try:
                answer = self._bus.ask(LIGHT_LOG_BEGIN, timeout_s=1.0)
            except BusError:
                return
            asked_s, promised = time.monotonic(), answer is not None
            if answer is None:
                with self._lock:
                    self._is_wanted = True
