"""Which hosts and origins may talk to the gateway, and what its pages may do. Parses addresses; never compares prefixes."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_HOST_NAME = re.compile(r"[a-z0-9](?:[a-z0-9-]{0,62}\.?)*\Z")
_DEFAULT_PORTS = {"http": 80, "https": 443, "ws": 80, "wss": 443}


def split_host(header: str) -> tuple[str, int | None] | None:
    """Host (lower case, no brackets) and port of a Host header; None if it is not one."""
    if not header or len(header) > 255 or any(character in header for character in "/@?#\\ \t"):
        return None
    try:
        parts = urlsplit(f"//{header}")
        host, port = parts.hostname, parts.port
    except ValueError:
        return None
    if not host or (not _as_address(host) and not _HOST_NAME.match(host)):
        return None
    return host.rstrip("."), port


def _as_address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


@dataclass(frozen=True, slots=True)
class HostPolicy:
    """Names and addresses under which the service may be reached.

    Loopback addresses and `localhost` always; with `lan` also the address that the connection arrived at and this machine's own names;
    `allowed_hosts` besides. A name that only resolves to this machine (DNS rebinding) is none of these.
    """

    allowed_hosts: frozenset[str] = frozenset()
    lan: bool = False

    @classmethod
    def create(cls, allowed_hosts: Iterable[str] = (), *, lan: bool = False) -> HostPolicy:
        """Build a policy; with `lan` the machine's name, with and without `.local`, is allowed too."""
        names = {name.lower().rstrip(".") for name in allowed_hosts}
        if lan:
            own = socket.gethostname().lower().split(".")[0]
            names |= {own, f"{own}.local"}
        return cls(frozenset(names), lan)

    def allows_host(self, header: str, server_address: str | None) -> bool:
        """Whether a Host header is acceptable on a connection to `server_address`."""
        parsed = split_host(header)
        if parsed is None:
            return False
        host, _ = parsed
        if host == "localhost" or host in self.allowed_hosts:
            return True
        address = _as_address(host)
        if address is None:
            return False
        if address.is_loopback:
            return True
        return self.lan and server_address is not None and address == _as_address(server_address)

    def allows_origin(self, origin: str, host_header: str) -> bool:
        """Whether an Origin header names the page's own host and port."""
        host = split_host(host_header)
        try:
            parts = urlsplit(origin)
            port = parts.port
        except ValueError:
            return False
        if (
            host is None
            or parts.scheme not in ("http", "https")
            or parts.path
            or parts.query
            or parts.username
        ):
            return False
        default = _DEFAULT_PORTS[parts.scheme]
        return ((parts.hostname or "").rstrip("."), port or default) == (host[0], host[1] or default)


def content_security_policy(host_header: str) -> str:
    """What pages may load: their own origin only; `blob:` for textures inside GLB files and for workers."""
    sockets = f"ws://{host_header} wss://{host_header}" if split_host(host_header) else ""
    return "; ".join(
        [
            "default-src 'self'",
            # Older Safari does not count a websocket to the same host as 'self'.
            f"connect-src 'self' blob: {sockets}".rstrip(),
            "img-src 'self' blob: data:",
            "worker-src 'self' blob:",
            "object-src 'none'",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        ]
    )


class Guard:
    """ASGI middleware: refuses foreign hosts and origins, adds security headers to every response."""

    def __init__(self, app: ASGIApp, policy: HostPolicy, on_refused: Callable[[], None]) -> None:
        self.app, self.policy, self.on_refused = app, policy, on_refused

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        refusal = self._refusal(headers, host, scope)
        if refusal is not None:
            self.on_refused()
            await _refuse(refusal, scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                added = MutableHeaders(scope=message)
                added.setdefault("Content-Security-Policy", content_security_policy(host))
                added.setdefault("X-Content-Type-Options", "nosniff")
                added.setdefault("Referrer-Policy", "no-referrer")
                added.setdefault("Cross-Origin-Resource-Policy", "same-origin")
                added.setdefault("Cross-Origin-Opener-Policy", "same-origin")
            await send(message)

        await self.app(scope, receive, send_with_headers)

    def _refusal(self, headers: Headers, host: str, scope: Scope) -> str | None:
        server: Any = scope.get("server")
        if len(headers.getlist("host")) != 1 or not self.policy.allows_host(
            host, server[0] if server else None
        ):
            return (
                f"Host {host[:100]!r} is not an address of this service. Open it by localhost or its IP address, "
                "or allow the name with --allow-host."
            )
        origins = headers.getlist("origin")
        # Browsers always name the origin of a websocket; tools that are no browsers need not.
        if origins and not (len(origins) == 1 and self.policy.allows_origin(origins[0], host)):
            return f"Origin {origins[0][:100]!r} may not use this service; open its own page."
        return None


async def _refuse(text: str, scope: Scope, receive: Receive, send: Send) -> None:
    response = PlainTextResponse(text + "\n", status_code=403)
    if scope["type"] == "http":
        await response(scope, receive, send)
        return
    await deny_websocket(response, receive, send)


async def deny_websocket(
    response: PlainTextResponse, receive: Receive, send: Callable[[Message], Awaitable[None]]
) -> None:
    """Answer a websocket handshake with a plain HTTP response (ASGI extension `websocket.http.response`)."""
    await receive()
    headers = [*response.raw_headers]
    await send({"type": "websocket.http.response.start", "status": response.status_code, "headers": headers})
    await send({"type": "websocket.http.response.body", "body": bytes(response.body)})
