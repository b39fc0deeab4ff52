"""Zenoh sessions between camera nodes and a service: TLS with certificates on both sides, and rights by the name in the certificate.

    node --TLS--> gate (the one listening port of the service) --loopback--> capture processes

The gate is a zenoh router inside a process of its own; nodes and capture processes are its clients, which come back by themselves when
the connection was lost. It knows no frames: it checks certificates and rights, and passes bytes on. The bus of the room is another
session that stays on loopback; nothing that a node sends can reach it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any, Literal

import structlog
import zenoh

from nearfield_server.bus.keys import room_prefix
from nearfield_server.capture.remote.certificates import CertificateFiles
from nearfield_server.errors import BusError

_log = structlog.get_logger("nearfield.remote")

Kind = Literal["frame", "answer", "wish", "alive"]
_FROM_NODE: tuple[Kind, ...] = ("frame", "answer")
_ALL_MESSAGES = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
]
_LEASE_MS = 2000
_HANDSHAKE_LIMIT_MS = 3000


def remote_key(room: str, node: str, camera: str, kind: Kind) -> str:
    """Return the key of one kind of message of one camera."""
    return f"{room_prefix(room)}/remote/{node}/{camera}/{kind}"


def gate_config(
    room: str, address: str, local_port: int, files: CertificateFiles, nodes: Sequence[str], max_message: int
) -> dict[str, Any]:
    """Return the zenoh configuration of the gate.

    Args:
        room: name of the room.
        address: "host:port" that nodes connect to.
        local_port: port on loopback for the capture processes.
        files: the service's.
        nodes: names of the nodes that may join; any other certificate of the room's authority can connect but say nothing.
        max_message: bytes of the largest message; more is not even received.
    """
    config = _common(["tls", "tcp"])
    config["mode"] = "router"
    config["listen"] = {
        "endpoints": [f"tls/{address}", f"tcp/127.0.0.1:{local_port}"],
        "exit_on_failure": True,
        "timeout_ms": 0,
    }
    config["transport"]["link"]["rx"] = {"max_message_size": max_message}
    config["transport"]["link"]["tls"] = {
        "root_ca_certificate": str(files.authority),
        "listen_certificate": str(files.certificate),
        "listen_private_key": str(files.key),
        "enable_mtls": True,
        "close_link_on_expiration": True,
    }
    config["access_control"] = access_control(room, nodes)
    return config


def access_control(room: str, nodes: Sequence[str]) -> dict[str, Any]:
    """Return who may say what: capture processes everything under `remote`, a node its own frames and answers, all others nothing."""
    rules = [_rule("local", _ALL_MESSAGES, ["ingress", "egress"], [f"{room_prefix(room)}/remote/**"])]
    subjects: list[dict[str, Any]] = [{"id": "local", "link_protocols": ["tcp"]}]
    policies = [{"rules": ["local"], "subjects": ["local"]}]
    for node in nodes:
        sent = [remote_key(room, node, "*", kind) for kind in _FROM_NODE]
        alive, wish = remote_key(room, node, "*", "alive"), remote_key(room, node, "*", "wish")
        own = [
            _rule(f"{node} sends", ["put"], ["ingress"], sent),
            _rule(f"{node} is alive", ["liveliness_token"], ["ingress"], [alive]),
            _rule(f"{node} asks for wishes", ["declare_subscriber"], ["ingress"], [wish]),
            _rule(f"{node} hears wishes", ["put"], ["egress"], [wish]),
            # Without this it would not learn that anyone listens, and send nothing.
            _rule(f"{node} is asked", ["declare_subscriber"], ["egress"], sent),
            _rule(f"{node} is watched", ["declare_liveliness_subscriber"], ["egress"], [alive]),
        ]
        rules += own
        subjects.append({"id": node, "link_protocols": ["tls"], "cert_common_names": [node]})
        policies.append({"rules": [rule["id"] for rule in own], "subjects": [node]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(name: str, messages: list[str], flows: list[str], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "messages": messages, "flows": flows, "permission": "allow", "key_exprs": keys}


def node_config(address: str, files: CertificateFiles) -> dict[str, Any]:
    """Return the zenoh configuration of one camera of a node: a client of the gate at `address` ("host:port")."""
    config = _client(f"tls/{address}", "tls")
    config["transport"]["link"]["tls"] = {
        "root_ca_certificate": str(files.authority),
        "connect_certificate": str(files.certificate),
        "connect_private_key": str(files.key),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }
    # A frame is many fragments; on a narrow link each waits for the one before. Frames that come meanwhile are left out instead.
    config["transport"]["link"]["tx"]["queue"] = {
        "congestion_control": {"drop": {"max_wait_before_drop_fragments": 500_000}}
    }
    return config


def local_config(local_port: int) -> dict[str, Any]:
    """Return the zenoh configuration of a capture process: a client of the gate on loopback."""
    return _client(f"tcp/127.0.0.1:{local_port}", "tcp")


def _client(endpoint: str, protocol: str) -> dict[str, Any]:
    config = _common([protocol])
    config["mode"] = "client"
    config["listen"] = {"endpoints": []}
    # Opening fails at once when nobody is there; a session that was open comes back by itself.
    config["connect"] = {
        "endpoints": [endpoint],
        "timeout_ms": 0,
        "exit_on_failure": True,
        "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
    }
    return config


def _common(protocols: list[str]) -> dict[str, Any]:
    return {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "unicast": {"open_timeout": _HANDSHAKE_LIMIT_MS, "accept_timeout": _HANDSHAKE_LIMIT_MS},
            "link": {"protocols": protocols, "tx": {"lease": _LEASE_MS, "keep_alive": 4}},
            "shared_memory": {"enabled": False},
        },
    }


def open_session(config: dict[str, Any], where: str) -> Any:
    """Open a zenoh session.

    Args:
        config: one of the configurations above.
        where: for the message.

    Raises:
        BusError: nobody listens there, the port is in use, or TLS fails.
    """
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except zenoh.ZError as error:
        raise BusError(f"{where}: {error}") from error


class RemoteLink:
    """One camera's end of the connection, on either side. Callbacks run in threads of zenoh.

    Args:
        config: `node_config` or `local_config`.
        room: name of the room. node: of the machine. camera: of the camera there.

    Raises:
        BusError: it cannot be opened.
    """

    def __init__(self, config: dict[str, Any], room: str, node: str, camera: str) -> None:
        self._names = (room, node, camera)
        self._declared: list[Any] = []
        self._session = open_session(config, f"connection of camera {node}/{camera}")

    def put(self, kind: Kind, payload: bytes) -> None:
        """Send. Frames are dropped when the link is congested; what is small overtakes them.

        Raises:
            BusError: the session is closed.
        """
        priority = zenoh.Priority.DATA_LOW if kind == "frame" else zenoh.Priority.INTERACTIVE_HIGH
        try:
            self._session.put(
                remote_key(*self._names, kind),
                payload,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=priority,
                express=True,
            )
        except zenoh.ZError as error:
            raise BusError(f"camera {self._names[1]}/{self._names[2]}: cannot send: {error}") from error

    def subscribe(self, kind: Kind, callback: Callable[[Any], None]) -> None:
        """Call `callback(payload)` for every message; `payload.to_bytes()` copies it out."""

        def receive(sample: Any) -> None:
            try:
                callback(sample.payload)
            except Exception:
                _log.exception("message handler failed", key=str(sample.key_expr))

        self._declared.append(self._session.declare_subscriber(remote_key(*self._names, kind), receive))

    def announce(self) -> None:
        """Show that the camera's process is there for as long as this session is."""
        key = remote_key(*self._names, "alive")
        self._declared.append(self._session.liveliness().declare_token(key))

    def watch_alive(self, callback: Callable[[bool], None]) -> None:
        """Call `callback(is there)` when the other end comes and goes; at once if it is there already."""

        def changed(sample: Any) -> None:
            callback(sample.kind == zenoh.SampleKind.PUT)

        key = remote_key(*self._names, "alive")
        self._declared.append(self._session.liveliness().declare_subscriber(key, changed, history=True))

    def close(self) -> None:
        """Leave; may be called twice."""
        self._declared.clear()
        if not self._session.is_closed():
            self._session.close()
