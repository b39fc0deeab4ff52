"""Certificates: what is made works in TLS, what does not fit is refused in words before TLS sees it."""

from __future__ import annotations

import datetime
import socket
import ssl
import threading
from pathlib import Path

import pytest

from nearfield_server.capture.remote.certificates import (
    SERVICE_NAME,
    CertificateFiles,
    check_files,
    new_node,
    new_room,
    read_certificate,
    why_no_connection,
)
from nearfield_server.errors import ConfigError


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("room")
    new_room(folder, ["127.0.0.1", "camera-server.lan"])
    new_node(folder, "window")
    return folder


@pytest.fixture(scope="module")
def other_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("other")
    new_room(folder, ["127.0.0.1"])
    new_node(folder, "window")
    return folder


def test_keys_are_private_and_files_are_right(room: Path) -> None:
    for name in ("ca.key", "service.key", "window.key"):
        assert (room / name).stat().st_mode & 0o777 == 0o600
    service, node = (CertificateFiles.in_folder(room, name) for name in (SERVICE_NAME, "window"))
    assert check_files(service, common_name="service", address="127.0.0.1") == []
    assert check_files(service, address="camera-server.lan") == []
    assert check_files(node, common_name="window") == []


def test_nothing_is_overwritten(room: Path) -> None:
    with pytest.raises(ConfigError, match="is there already; a new authority would lock out"):
        new_room(room, ["127.0.0.1"])
    with pytest.raises(ConfigError, match="is there already"):
        new_node(room, "window")
    for name in ("service", "ca"):
        with pytest.raises(ConfigError, match="cannot be called"):
            new_node(room, name)


@pytest.mark.parametrize("name", ["", "../up", "a/b", "é", "two words", "-x", "x" * 65, "x\n"])
def test_a_node_has_a_name_that_node_files_and_room_files_take(room: Path, name: str) -> None:
    before = sorted(room.parent.rglob("*"))
    with pytest.raises(ConfigError, match="expected 1 to 64 letters"):
        new_node(room, name)
    assert sorted(room.parent.rglob("*")) == before


@pytest.mark.parametrize("address", ["", "é.lan", "192.168.10.5:7448", "https://server.lan", "two words"])
def test_a_wrong_address_is_not_in_the_way_of_the_right_one(tmp_path: Path, address: str) -> None:
    with pytest.raises(ConfigError, match="expected an IP address or a host name"):
        new_room(tmp_path, ["127.0.0.1", address])
    assert list(tmp_path.iterdir()) == []
    new_room(tmp_path, ["127.0.0.1"])


def test_a_service_certificate_that_is_left_over_is_told_before_an_authority_is_made(tmp_path: Path) -> None:
    new_room(tmp_path, ["127.0.0.1"])
    for name in ("ca.pem", "ca.key"):
        (tmp_path / name).unlink()
    with pytest.raises(ConfigError, match=r"service\.pem or its key is there already"):
        new_room(tmp_path, ["127.0.0.1"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["service.key", "service.pem"]


def test_what_is_wrong_is_said(room: Path, other_room: Path, tmp_path: Path) -> None:
    node = CertificateFiles.in_folder(room, "window")
    with pytest.raises(ConfigError, match="is for 'window', expected 'door'"):
        check_files(node, common_name="door")
    with pytest.raises(ConfigError, match=r"is for .*127\.0\.0\.1, but the service listens on 10\.0\.0\.1"):
        check_files(CertificateFiles.in_folder(room, SERVICE_NAME), address="10.0.0.1")
    with pytest.raises(ConfigError, match=r"door\.pem: cannot be read"):
        check_files(CertificateFiles.in_folder(room, "door"))
    strange = CertificateFiles(authority=other_room / "ca.pem", certificate=node.certificate, key=node.key)
    with pytest.raises(ConfigError, match=r"not signed by the authority .* different rooms"):
        check_files(strange)
    mixed = CertificateFiles(authority=node.authority, certificate=node.certificate, key=room / "service.key")
    with pytest.raises(ConfigError, match="is not the key of"):
        check_files(mixed)
    (tmp_path / "ca.pem").write_text("hello")
    with pytest.raises(ConfigError, match="expected a certificate in PEM form"):
        read_certificate(tmp_path / "ca.pem")


def test_validity_is_judged_by_the_clock(room: Path) -> None:
    node = CertificateFiles.in_folder(room, "window")
    now = datetime.datetime.now(datetime.UTC)
    with pytest.raises(ConfigError, match=r"window\.pem expired on"):
        check_files(node, now=now + datetime.timedelta(days=826))
    with pytest.raises(ConfigError, match=r"is not valid before .* set the clock"):
        check_files(node, now=now - datetime.timedelta(days=1))
    soon = check_files(node, now=now + datetime.timedelta(days=800))
    assert any("expires in 24 days" in warning or "expires in 25 days" in warning for warning in soon)


def test_a_key_that_others_may_read_is_warned_of(room: Path, tmp_path: Path) -> None:
    for name in ("ca.pem", "window.pem", "window.key"):
        (tmp_path / name).write_bytes((room / name).read_bytes())
    (tmp_path / "window.key").chmod(0o644)
    assert "chmod 600" in check_files(CertificateFiles.in_folder(tmp_path, "window"))[0]


class Server:
    """Accepts TLS connections with certificates of the room's authority alone."""

    def __init__(self, folder: Path) -> None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(folder / "service.pem", folder / "service.key")
        context.load_verify_locations(folder / "ca.pem")
        context.verify_mode = ssl.CERT_REQUIRED
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        self._context = context
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                raw, _ = self._listener.accept()
            except OSError:
                return
            with raw:
                try:
                    with self._context.wrap_socket(raw, server_side=True) as tls:
                        tls.settimeout(5.0)
                        tls.recv(1)
                except OSError:
                    continue

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()


def test_a_refused_connection_is_explained(room: Path, other_room: Path) -> None:
    server = Server(room)
    try:
        good = CertificateFiles.in_folder(room, "window")
        assert why_no_connection("127.0.0.1", server.port, good) == ""
        stranger = CertificateFiles.in_folder(other_room, "window")
        assert "does not vouch for" in why_no_connection("127.0.0.1", server.port, stranger)
        # It trusts our authority, but shows a certificate of another one.
        forged = CertificateFiles(
            authority=room / "ca.pem", certificate=stranger.certificate, key=stranger.key
        )
        assert "refuses the certificate" in why_no_connection("127.0.0.1", server.port, forged)
    finally:
        server.close()
    assert "cannot be reached" in why_no_connection("127.0.0.1", server.port, good)
