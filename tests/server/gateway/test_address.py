"""What people are told."""

from __future__ import annotations

import ipaddress

import pytest

from nearfield_server.gateway import address


def test_loopback_names_no_network_address() -> None:
    text = address.describe_address(8080)
    assert "http://127.0.0.1:8080/" in text
    assert "--lan" in text
    assert len(text.splitlines()) > 10, "the QR code is missing"
    assert "Tablets" not in text


def test_lan_address_and_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(address, "lan_addresses", lambda: ("2001:db8::7", "192.0.2.7"))
    text = address.describe_address(8080, lan=True)
    assert "http://192.0.2.7:8080/" in text
    assert len(text.splitlines()) > 10
    assert len(address.describe_address(8080, lan=True, qr=False).splitlines()) == 2


def test_machine_without_network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(address, "lan_addresses", lambda: ())
    assert "no network address" in address.describe_address(8080, lan=True)


@pytest.mark.parametrize(
    ("host", "port", "url"),
    [("127.0.0.1", 80, "http://127.0.0.1/"), ("2001:db8::7", 8080, "http://[2001:db8::7]:8080/")],
)
def test_urls(host: str, port: int, url: str) -> None:
    assert address.page_url(host, port) == url


def test_own_addresses_are_reachable_ones() -> None:
    for found in address.lan_addresses():
        assert not ipaddress.ip_address(found).is_loopback
