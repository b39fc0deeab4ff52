"""Starting and stopping."""

from __future__ import annotations

import asyncio
import socket
import threading
from pathlib import Path

import httpx
import pytest

from nearfield_server.errors import ServiceError
from nearfield_server.gateway.app import create_app
from nearfield_server.gateway.hub import LightHub
from nearfield_server.gateway.listener import open_listener, tune_listener
from nearfield_server.gateway.ports import NoControls
from nearfield_server.gateway.scene_description import SceneDescription
from nearfield_server.gateway.server import serve_app, serve_in_thread

from .conftest import scene_json


def make_app(tmp_path: Path):
    return create_app(SceneDescription.model_validate(scene_json()), LightHub(), NoControls(), tmp_path)


async def test_serves_on_a_given_socket_until_stopped(tmp_path: Path) -> None:
    listener, stop = open_listener("127.0.0.1", 0), asyncio.Event()
    port = listener.getsockname()[1]
    serving = asyncio.create_task(serve_app(make_app(tmp_path), listener=listener, stop=stop))
    async with httpx.AsyncClient() as client, asyncio.timeout(10):
        answer = await client.get(f"http://127.0.0.1:{port}/api/status")
        assert answer.status_code == 200
        stop.set()
        await serving
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), timeout=1).close()


async def test_port_in_use(tmp_path: Path) -> None:
    with open_listener("127.0.0.1", 0) as taken, pytest.raises(ServiceError, match="choose another port"):
        await serve_app(make_app(tmp_path), port=taken.getsockname()[1])


def test_foreign_address_is_refused_in_words() -> None:
    with pytest.raises(ServiceError, match=r"192\.0\.2\.1 port 0"):
        open_listener("192.0.2.1", 0)


def test_accepted_sockets_inherit_the_limits() -> None:
    with open_listener("127.0.0.1", 0) as listener:
        tune_listener(listener, user_timeout_ms=1234)
        with socket.create_connection(listener.getsockname()) as client:
            listener.setblocking(True)
            accepted, _ = listener.accept()
            with accepted:
                assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 1234
                assert accepted.getsockopt(socket.IPPROTO_TCP, 25) == 16384
                client.shutdown(socket.SHUT_RDWR)


def test_a_thread_is_gone_afterwards(tmp_path: Path) -> None:
    before = threading.active_count()
    with serve_in_thread(make_app(tmp_path)) as url:
        assert httpx.get(url + "api/scene").status_code == 200
    assert threading.active_count() == before
