"""The message bus: a zenoh session that talks over loopback only.

One session (the supervisor's) listens on a known port; the others connect to it, listen on ports that the kernel chooses,
and learn of each other by gossip. Messages go straight from process to process, so the light goes on while the supervisor is away.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from types import TracebackType
from typing import Any

import structlog
import zenoh

from nearfield_server.bus.keys import ALIVE, alive_key, room_prefix
from nearfield_server.errors import BusError

_log = structlog.get_logger("nearfield.bus")


def loopback_config(*, listen_port: int | None = None, connect_port: int | None = None) -> dict[str, Any]:
    """Return the zenoh configuration: TCP on 127.0.0.1 and nothing else.

    Args:
        listen_port: known port of the supervisor's session; None = any free port.
        connect_port: the supervisor's port; None for the supervisor itself. Connecting is retried for ever, and opening does
            not wait for it.
    """
    return {
        "mode": "peer",
        "listen": {
            "endpoints": [f"tcp/127.0.0.1:{listen_port or 0}"],
            "exit_on_failure": True,
            "timeout_ms": 0,
        },
        "connect": {
            "endpoints": [f"tcp/127.0.0.1:{connect_port}"] if connect_port else [],
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": {"period_init_ms": 50, "period_max_ms": 1000, "period_increase_factor": 2},
        },
        "scouting": {
            "multicast": {"enabled": False},
            "gossip": {"enabled": True, "multihop": False, "autoconnect": {"peer": ["peer"]}},
        },
        # A frozen process is noticed after the lease; a dead one at once, because its sockets close.
        "transport": {"link": {"tx": {"lease": 2000, "keep_alive": 4}}, "shared_memory": {"enabled": False}},
    }


class Bus:
    """A session on the bus of one room. Keys are relative to the room, as in `bus.keys`.

    Callbacks run in threads of zenoh; an exception in one is logged and ends only that call.
    """

    def __init__(self, room: str, *, listen_port: int | None = None, connect_port: int | None = None) -> None:
        """Open the session.

        Args:
            room: name of the room; different rooms do not hear each other.
            listen_port: see `loopback_config`.
            connect_port: see `loopback_config`.

        Raises:
            BusError: the port is in use, or zenoh refuses.
        """
        self._prefix = room_prefix(room)
        self._declared: list[Any] = []
        config = json.dumps(loopback_config(listen_port=listen_port, connect_port=connect_port))
        try:
            self._session = zenoh.open(zenoh.Config.from_json5(config))
        except zenoh.ZError as error:
            where = f"port {listen_port} of 127.0.0.1" if listen_port else "a port of 127.0.0.1"
            raise BusError(
                f"message bus cannot listen on {where}: {error}. Stop the other program or choose another port"
            ) from error

    def __enter__(self) -> Bus:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _key(self, key: str) -> str:
        return f"{self._prefix}/{key}"

    def put(self, key: str, payload: bytes, *, must_arrive: bool = False) -> None:
        """Send to all subscribers of a key.

        Args:
            key: relative key.
            payload: the bytes.
            must_arrive: wait for room in a full queue (control messages); otherwise the message is dropped (newest wins).

        Raises:
            BusError: the session is closed.
        """
        congestion = zenoh.CongestionControl.BLOCK if must_arrive else zenoh.CongestionControl.DROP
        try:
            self._session.put(self._key(key), payload, congestion_control=congestion, express=True)
        except zenoh.ZError as error:
            raise BusError(f"message bus: cannot send '{key}': {error}") from error

    def subscribe(self, key: str, callback: Callable[[str, bytes], None]) -> None:
        """Call `callback(relative key, payload)` for every message under a key (`*` matches one part)."""

        def receive(sample: Any) -> None:
            relative = str(sample.key_expr).removeprefix(f"{self._prefix}/")
            try:
                callback(relative, sample.payload.to_bytes())
            except Exception:
                _log.exception("message handler failed", key=relative)

        self._declared.append(self._session.declare_subscriber(self._key(key), receive))

    def answer(self, key: str, reply: Callable[[], bytes]) -> None:
        """Answer questions for a key with what `reply()` returns at that moment."""
        self.answer_question(key, lambda _: reply())

    def answer_question(self, key: str, reply: Callable[[bytes], bytes]) -> None:
        """Answer questions for a key with `reply(question)`."""
        full_key = self._key(key)

        def respond(query: Any) -> None:
            try:
                payload = query.payload
                query.reply(full_key, reply(b"" if payload is None else payload.to_bytes()))
            except Exception:
                _log.exception("answering failed", key=key)

        self._declared.append(self._session.declare_queryable(full_key, respond))

    def ask(self, key: str, timeout_s: float = 1.0, question: bytes = b"") -> bytes | None:
        """Ask for a key, with more about what is wanted in `question`; return the first answer, or None if there is none in time.

        Raises:
            BusError: the session is closed.
        """
        try:
            for answer in self._session.get(self._key(key), timeout=timeout_s, payload=question or None):
                if answer.ok is not None:
                    payload: bytes = answer.ok.payload.to_bytes()
                    return payload
        except zenoh.ZError as error:
            raise BusError(f"message bus: cannot ask for '{key}': {error}") from error
        return None

    def announce(self, process: str) -> None:
        """Show that a process is alive for as long as this session is."""
        self._declared.append(self._session.liveliness().declare_token(self._key(alive_key(process))))

    def watch_alive(self, callback: Callable[[str, bool], None]) -> None:
        """Call `callback(process, is_alive)` for every announced process, those already there included."""

        def changed(sample: Any) -> None:
            process = str(sample.key_expr).rpartition("/")[2]
            try:
                callback(process, sample.kind == zenoh.SampleKind.PUT)
            except Exception:
                _log.exception("liveliness handler failed", process=process)

        self._declared.append(
            self._session.liveliness().declare_subscriber(self._key(f"{ALIVE}/*"), changed, history=True)
        )

    def close(self) -> None:
        """Leave the bus; may be called twice."""
        self._declared.clear()
        if not self._session.is_closed():
            self._session.close()  # type: ignore[no-untyped-call]
