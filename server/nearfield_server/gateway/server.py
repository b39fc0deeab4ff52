"""Running the application: uvicorn, and a server in a thread for tools and tests."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

import uvicorn
from starlette.types import ASGIApp

from nearfield_server.errors import ServiceError
from nearfield_server.gateway.listener import open_listener, tune_listener

_WS_MAX_BYTES = 64 * 1024
_SHUTDOWN_S = 2


class _Server(uvicorn.Server):
    """uvicorn without its own signal handlers: the process decides when to stop."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Ignore: signals are not captured here."""


def make_server(app: ASGIApp, **options: Any) -> uvicorn.Server:
    """A uvicorn server for the application; `options` override its configuration."""
    settings: dict[str, Any] = {
        "ws": "websockets-sansio",
        "ws_max_size": _WS_MAX_BYTES,
        "ws_per_message_deflate": False,
        "http": "h11",
        "lifespan": "on",
        "log_config": None,
        "access_log": False,
        "server_header": False,
        "proxy_headers": False,
        "timeout_keep_alive": 5,
        # Far above what the allowed clients need; bounds what a flood of connections can cost.
        "limit_concurrency": 512,
        "timeout_graceful_shutdown": _SHUTDOWN_S,
    }
    return _Server(uvicorn.Config(app, **{**settings, **options}))


async def serve_app(
    app: ASGIApp,
    host: str = "127.0.0.1",
    port: int = 8080,
    *,
    listener: socket.socket | None = None,
    stop: asyncio.Event | None = None,
    user_timeout_ms: int = 5000,
) -> None:
    """Serve until `stop` is set; clients are told 1012 (service restart).

    Args:
        app: from `create_app`.
        host: address to bind; unused with `listener`.
        port: TCP port, 0 = any free one; unused with `listener`.
        listener: a socket that listens already.
        stop: ends the server.
        user_timeout_ms: a peer that takes nothing for so long is dropped.

    Raises:
        ServiceError: the port is in use, or the application does not start.
    """
    own = listener or open_listener(host, port)
    tune_listener(own, user_timeout_ms)
    server = make_server(app)

    async def wait_for_stop() -> None:
        assert stop is not None
        await stop.wait()
        server.should_exit = True

    watcher = asyncio.create_task(wait_for_stop()) if stop is not None else None
    try:
        await server.serve(sockets=[own])
    finally:
        if watcher is not None:
            watcher.cancel()
        own.close()
    if not server.started:
        raise ServiceError("the web server did not start; see the log above")


@contextlib.contextmanager
def serve_in_thread(
    app: ASGIApp, host: str = "127.0.0.1", port: int = 0, *, user_timeout_ms: int = 5000
) -> Iterator[str]:
    """Serve from a thread of its own; yields the URL, `http://127.0.0.1:43210/`.

    Raises:
        ServiceError: the port is in use, or the application does not start.
    """
    listener = open_listener(host, port)
    tune_listener(listener, user_timeout_ms)
    bound: int = listener.getsockname()[1]
    server = make_server(app)
    thread = threading.Thread(
        target=lambda: asyncio.run(server.serve(sockets=[listener])), name="gateway", daemon=True
    )
    thread.start()
    try:
        while not server.started:
            if not thread.is_alive():
                raise ServiceError("the web server did not start; see the log above")
            thread.join(0.01)
        yield f"http://{f'[{host}]' if ':' in host else host}:{bound}/"
    finally:
        server.should_exit = True
        thread.join(_SHUTDOWN_S + 3)
        listener.close()
