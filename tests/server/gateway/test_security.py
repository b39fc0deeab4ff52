"""Hosts, origins and paths, by raw sockets where a library would tidy the request up."""

from __future__ import annotations

import re
from pathlib import Path

import httpx
import pytest
from websockets.exceptions import InvalidStatus

from nearfield_server.gateway.security import HostPolicy, content_security_policy, split_host

from .conftest import StartGateway


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("localhost:8080", ("localhost", 8080)),
        ("127.0.0.1", ("127.0.0.1", None)),
        ("[::1]:80", ("::1", 80)),
        ("Tablet.Local.", ("tablet.local", None)),
        ("", None),
        ("a b", None),
        ("user@localhost", None),
        ("localhost:99999", None),
        ("localhost:x", None),
        ("[::1", None),
        ("localhost/..", None),
        ("exa_mple", None),
    ],
)
def test_split_host(header: str, expected: tuple[str, int | None] | None) -> None:
    assert split_host(header) == expected


@pytest.mark.parametrize(
    ("header", "lan", "allowed"),
    [
        ("localhost", False, True),
        ("127.0.0.1:8080", False, True),
        ("127.9.9.9", False, True),
        ("[::1]:8080", False, True),
        ("127.attacker.example", False, False),
        ("127.0.0.1.attacker.example", False, False),
        ("localhost.attacker.example", False, False),
        ("192.0.2.7:8080", False, False),
        ("192.0.2.7:8080", True, True),
        ("192.0.2.8:8080", True, False),
        ("attacker.example", True, False),
        ("desk.example", False, True),
        ("2130706433", False, False),
        ("0x7f000001", False, False),
    ],
)
def test_hosts(header: str, lan: bool, allowed: bool) -> None:
    policy = HostPolicy.create(["Desk.example"], lan=lan)
    assert policy.allows_host(header, "192.0.2.7") is allowed


@pytest.mark.parametrize(
    ("origin", "host", "allowed"),
    [
        ("http://localhost:8080", "localhost:8080", True),
        ("https://localhost", "localhost:443", True),
        ("http://localhost", "localhost", True),
        ("http://localhost:8081", "localhost:8080", False),
        ("http://127.0.0.1:8080", "localhost:8080", False),
        ("http://evil.example", "localhost:8080", False),
        ("http://localhost:8080.evil.example", "localhost:8080", False),
        ("http://localhost:8080@evil.example", "localhost:8080", False),
        ("null", "localhost:8080", False),
        ("", "localhost:8080", False),
        ("file://", "localhost:8080", False),
        ("http://[::1]:8080", "[::1]:8080", True),
        ("http://[", "localhost", False),
    ],
)
def test_origins(origin: str, host: str, allowed: bool) -> None:
    assert HostPolicy.create().allows_origin(origin, host) is allowed


def request(path: str, headers: str) -> str:
    return f"GET {path} HTTP/1.1\n{headers}Connection: close\n\n"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ("Host: 127.0.0.1\n", b"200"),
        ("Host: localhost\nOrigin: http://localhost\n", b"200"),
        ("Host: evil.example\n", b"403"),
        ("Host: 127.evil.example\n", b"403"),
        ("Host: localhost\nHost: localhost\n", b"40"),
        ("Host: localhost\nOrigin: http://evil.example\n", b"403"),
        ("Host: localhost\nOrigin: null\n", b"403"),
        ("Host: \n", b"403"),
    ],
)
def test_http_host_and_origin(start_gateway: StartGateway, headers: str, status: bytes) -> None:
    answer = start_gateway().raw(request("/api/scene", headers))
    assert answer.startswith(b"HTTP/1.1 " + status)


def test_websocket_of_a_foreign_page_is_refused(start_gateway: StartGateway) -> None:
    gateway = start_gateway()
    with pytest.raises(InvalidStatus) as caught:
        gateway.tablet(origin="http://evil.example")
    assert caught.value.response.status_code == 403
    assert b"evil.example" in caught.value.response.body
    assert gateway.tablet(origin=gateway.url.rstrip("/")).read()


@pytest.mark.parametrize(
    "path",
    [
        "/../secret.txt",
        "/%2e%2e/secret.txt",
        "/..%2fsecret.txt",
        "/assets/../../secret.txt",
        "/assets/%2e%2e/%2e%2e/secret.txt",
        "/assets/..%5c..%5csecret.txt",
        "/assets//etc/passwd",
        "//etc/passwd",
        "/assets/secret.txt",
        "/static/../../secret.txt",
        "/link/secret.txt",
    ],
)
def test_nothing_outside_is_served(start_gateway: StartGateway, tmp_path: Path, path: str) -> None:
    static = tmp_path / "static"
    (static / "assets").mkdir(parents=True)
    (static / "index.html").write_text("page")
    (tmp_path / "secret.txt").write_text("TOP SECRET")
    (static / "link").symlink_to(tmp_path)
    answer = start_gateway(static_dir=static).raw(request(path, "Host: localhost\n"))
    assert b"SECRET" not in answer
    assert b"root:" not in answer
    assert re.match(rb"HTTP/1.1 4\d\d", answer)


def test_security_headers(start_gateway: StartGateway) -> None:
    answer = httpx.get(start_gateway().url + "api/scene")
    policy = answer.headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "unsafe" not in policy
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert "access-control-allow-origin" not in answer.headers


def test_policy_names_the_own_socket_only() -> None:
    assert "connect-src 'self' blob: ws://desk:80 wss://desk:80;" in content_security_policy("desk:80")
    assert "evil" not in content_security_policy("evil; script-src *")
