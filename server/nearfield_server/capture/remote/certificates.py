"""Who may join a room: a certificate authority per room, one certificate for the service, one per camera node.

The common name of a node's certificate is the name of the node; the service admits a node to its own keys by it. Everything is
ECDSA on P-256, PEM files, private keys readable by their owner alone.
"""

from __future__ import annotations

import contextlib
import datetime
import os
import re
import ssl
from collections.abc import Sequence
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from nearfield_server.errors import ConfigError
from nearfield_server.scene.device_schema import REMOTE_NAME

AUTHORITY_NAME = "room authority"
SERVICE_NAME = "service"
AUTHORITY_FILES = ("ca.pem", "ca.key")
DEFAULT_DAYS = 825
_AUTHORITY_DAYS = 3650
# A node whose clock is a little behind must not find its new certificate "not yet valid".
_CLOCK_SLACK = datetime.timedelta(minutes=10)
_HOST_NAME = r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,252}"


@dataclass(frozen=True, slots=True, kw_only=True)
class CertificateFiles:
    """The three files with which one end of a TLS connection shows who it is, and checks the other end.

    Attributes:
        authority: certificate of the room's authority.
        certificate: of this end.
        key: private key of this end.
    """

    authority: Path
    certificate: Path
    key: Path

    @classmethod
    def in_folder(cls, folder: Path, name: str) -> CertificateFiles:
        """The files of a node, or of the service (`SERVICE_NAME`), under their usual names."""
        return cls(
            authority=folder / AUTHORITY_FILES[0],
            certificate=folder / f"{name}.pem",
            key=folder / f"{name}.key",
        )


def new_room(folder: Path, addresses: Sequence[str], days: int = DEFAULT_DAYS) -> CertificateFiles:
    """Make the authority of a room and the certificate of its service.

    Args:
        folder: made if it is missing; gets ca.pem, ca.key, service.pem, service.key.
        addresses: IP addresses or host names under which nodes reach the service.
        days: validity of the service's certificate; that of the authority is ten years.

    Raises:
        ConfigError: there is an authority or a certificate of the service already, no address is given or one is wrong,
            or the folder cannot be written. Where an argument is at fault, nothing is written.
    """
    if not addresses:
        raise ConfigError("expected at least one address under which nodes reach the service, found none")
    # An authority without a certificate of the service would be in the way of the next try: all that can be wrong is told first.
    names = [_alternative_name(address) for address in addresses]
    authority_file, authority_key_file = (folder / name for name in AUTHORITY_FILES)
    for path in (authority_file, authority_key_file):
        if path.exists():
            raise ConfigError(
                f"{path} is there already; a new authority would lock out every node that has joined. Choose another folder, or delete it"
            )
    _check_free(CertificateFiles.in_folder(folder, SERVICE_NAME))
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(AUTHORITY_NAME)
    certificate = (
        _builder(name, name, key.public_key(), _AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(for_authority=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    _write_key(authority_key_file, key)
    _write(authority_file, certificate.public_bytes(serialization.Encoding.PEM), 0o644)
    return _issue(folder, SERVICE_NAME, names, days, ExtendedKeyUsageOID.SERVER_AUTH)


def new_node(folder: Path, node: str, days: int = DEFAULT_DAYS) -> CertificateFiles:
    """Make the certificate of a camera node, signed by the authority in `folder`.

    Args:
        folder: where `new_room` has been; gets <node>.pem and <node>.key.
        node: name of the node, as room file and node file have it.
        days: validity.

    Raises:
        ConfigError: no authority there, no name that a node can have, the node has a certificate already, or the files cannot
            be written.
    """
    if not re.fullmatch(REMOTE_NAME, node):
        raise ConfigError(
            f"node {node[:80]!r}: expected 1 to 64 letters, digits, '_', '.' or '-' of ASCII, the first a letter or digit"
        )
    if node == SERVICE_NAME or f"{node}.key" in AUTHORITY_FILES:
        raise ConfigError(
            f"a node cannot be called '{node}': files of the room have that name. Choose another"
        )
    # Node certificates carry their name as alternative name too: some TLS libraries look at nothing else.
    names = [x509.DNSName(_as_dns(node))]
    return _issue(folder, node, names, days, ExtendedKeyUsageOID.CLIENT_AUTH)


def _check_free(files: CertificateFiles) -> None:
    if files.key.exists() or files.certificate.exists():
        raise ConfigError(
            f"{files.certificate} or its key is there already. Delete both to replace them, or choose another name"
        )


def _issue(
    folder: Path, common_name: str, names: Sequence[x509.GeneralName], days: int, usage: x509.ObjectIdentifier
) -> CertificateFiles:
    files = CertificateFiles.in_folder(folder, common_name)
    _check_free(files)
    authority = read_certificate(files.authority)
    authority_key = _read_key(folder / AUTHORITY_FILES[1])
    key = ec.generate_private_key(ec.SECP256R1())
    builder = _builder(_name(common_name), authority.subject, key.public_key(), days)
    certificate = (
        builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(for_authority=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key()), critical=False
        )
        .sign(authority_key, hashes.SHA256())
    )
    _write_key(files.key, key)
    _write(files.certificate, certificate.public_bytes(serialization.Encoding.PEM), 0o644)
    return files


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _as_dns(name: str) -> str:
    return name.replace("_", "-")


def _alternative_name(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(address))
    except ValueError:
        pass
    if not re.fullmatch(_HOST_NAME, address):
        raise ConfigError(
            f"address {address[:80]!r}: expected an IP address or a host name in ASCII, without a port"
        )
    return x509.DNSName(address)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCK_SLACK)
        .not_valid_after(now + datetime.timedelta(days=days))
    )


def _key_usage(*, for_authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not for_authority,
        key_cert_sign=for_authority,
        crl_sign=for_authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _write_key(path: Path, key: ec.EllipticCurvePrivateKey) -> None:
    pem = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    _write(path, pem, 0o600)


def _write(path: Path, content: bytes, mode: int) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Made with its mode, not changed to it afterwards: a key is never readable by others, not even for a moment.
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            file.write(content)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from error


def read_certificate(path: Path) -> x509.Certificate:
    """Read a PEM certificate.

    Raises:
        ConfigError: missing, unreadable, or no certificate.
    """
    try:
        return x509.load_pem_x509_certificate(_read(path))
    except ValueError as error:
        raise ConfigError(f"{path}: expected a certificate in PEM form ({error})") from error


def _read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    try:
        key = serialization.load_pem_private_key(_read(path), password=None)
    except (ValueError, TypeError) as error:
        raise ConfigError(
            f"{path}: expected a private key in PEM form without a password ({error})"
        ) from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise ConfigError(f"{path}: expected an elliptic curve key, found {type(key).__name__}")
    return key


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error


def check_files(
    files: CertificateFiles,
    *,
    common_name: str | None = None,
    address: str | None = None,
    now: datetime.datetime | None = None,
) -> list[str]:
    """Check before TLS does, whose errors name neither file nor reason.

    Args:
        files: of this end.
        common_name: name that the certificate must have; None = any.
        address: IP address or host name that the certificate must be for; None = it is not a service's.
        now: time of the check; None = the clock of this machine.

    Returns:
        Warnings in words: validity that ends within 30 days, a key that others may read.

    Raises:
        ConfigError: a file is missing or no PEM; a certificate is expired, not yet valid, of another authority or for another
            name; the key is not its own.
    """
    now = now or datetime.datetime.now(datetime.UTC)
    authority, certificate = read_certificate(files.authority), read_certificate(files.certificate)
    warnings: list[str] = []
    for path, checked in ((files.authority, authority), (files.certificate, certificate)):
        warnings += _check_validity(path, checked, now)
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature) as error:
        raise ConfigError(
            f"{files.certificate} is not signed by the authority in {files.authority}: they belong to different rooms. "
            "Make it anew with `nearfield certificates node`, or copy the ca.pem that belongs to it"
        ) from error
    key = _read_key(files.key)
    if key.public_key() != certificate.public_key():
        raise ConfigError(f"{files.key} is not the key of {files.certificate}; copy both from the same place")
    found = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    found_name = str(found[0].value) if found else ""
    if common_name is not None and found_name != common_name:
        raise ConfigError(
            f"{files.certificate} is for '{found_name}', expected '{common_name}'; "
            "a node can join under the name in its certificate alone"
        )
    if address is not None:
        _check_address(files.certificate, certificate, address)
    mode = files.key.stat().st_mode & 0o777
    if mode & 0o077:
        warnings.append(
            f"{files.key} can be read by others (mode {mode:04o}); make it private with chmod 600"
        )
    return warnings


def _check_validity(path: Path, certificate: x509.Certificate, now: datetime.datetime) -> list[str]:
    first, last = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if now > last:
        raise ConfigError(
            f"{path} expired on {last:%Y-%m-%d %H:%M} UTC; delete it and its key and make them anew with `nearfield certificates`"
        )
    if now < first:
        raise ConfigError(
            f"{path} is not valid before {first:%Y-%m-%d %H:%M} UTC, but this machine's clock says {now:%Y-%m-%d %H:%M}; set the clock"
        )
    days = (last - now).days
    return [f"{path} expires in {days} days, on {last:%Y-%m-%d}"] if days < 30 else []


def _check_address(path: Path, certificate: x509.Certificate, address: str) -> None:
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        known = names.get_values_for_type(x509.DNSName)
        known += [str(value) for value in names.get_values_for_type(x509.IPAddress)]
    except x509.ExtensionNotFound:
        known = []
    if address not in known:
        raise ConfigError(
            f"{path} is for {', '.join(known) or 'no address'}, but the service listens on {address}: nodes would refuse it. "
            "Make it anew with that --address"
        )


def tls_context(files: CertificateFiles) -> ssl.SSLContext:
    """Context of a node for a plain TLS connection to the service.

    Raises:
        ConfigError: a file is missing or none that TLS can use.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    try:
        context.load_verify_locations(files.authority)
        context.load_cert_chain(files.certificate, files.key)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(f"{files.certificate}, {files.key}: not usable for TLS ({error})") from error
    return context


def why_no_connection(host: str, port: int, files: CertificateFiles, timeout_s: float = 2.0) -> str:
    """Try a plain TLS connection to the service and say in words what stands in the way; empty if nothing does.

    Raises:
        ConfigError: the files cannot be used.
    """
    import socket

    context = tls_context(files)
    where = f"{host} port {port}"
    try:
        raw = socket.create_connection((host, port), timeout_s)
    except TimeoutError:
        return f"{where} does not answer: is the machine on, the cable in, the firewall open?"
    except OSError as error:
        return f"{where} cannot be reached ({error.strerror or error}): is the service running, and is this its address?"
    with contextlib.closing(raw):
        try:
            with context.wrap_socket(raw, server_hostname=host) as tls:
                # With TLS 1.3 the other end judges our certificate after our handshake is over; a refusal arrives as the next thing read.
                tls.settimeout(0.3)
                try:
                    tls.recv(1)
                except TimeoutError:
                    return ""
        except ssl.SSLCertVerificationError as error:
            return f"{where} shows a certificate that {files.authority} does not vouch for ({error.verify_message})"
        except (ssl.SSLError, ConnectionError) as error:
            reason = getattr(error, "reason", None) or str(error)
            return f"{where} refuses the certificate {files.certificate} ({reason.replace('_', ' ').lower()})"
        except TimeoutError:
            return f"{where} accepts connections but does not speak TLS within {timeout_s:.0f} s"
    return ""
