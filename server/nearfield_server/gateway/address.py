"""What to tell people: the address of the page, in words and as a QR code for tablets."""

from __future__ import annotations

import io
import ipaddress
import socket

import segno


def lan_addresses() -> tuple[str, ...]:
    """This machine's own addresses that other machines can reach, the one towards the default route first."""
    found: list[str] = []
    for family, target in ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1")):
        try:
            with socket.socket(family, socket.SOCK_DGRAM) as probe:
                # Connecting a datagram socket sends nothing; it makes the kernel choose the outgoing address.
                probe.connect((target, 9))
                found.append(probe.getsockname()[0])
        except OSError:
            continue
    try:
        entries = socket.getaddrinfo(socket.gethostname(), None, type=socket.SOCK_STREAM)
        found += [str(entry[4][0]) for entry in entries]
    except OSError:
        pass
    return tuple(dict.fromkeys(address for address in found if _is_reachable(address)))


def _is_reachable(address: str) -> bool:
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return False
    return not (parsed.is_loopback or parsed.is_link_local or parsed.is_unspecified)


def page_url(host: str, port: int) -> str:
    """URL of the page on an address or host name; port 80 is left out."""
    shown = f"[{host}]" if ":" in host else host
    return f"http://{shown}/" if port == 80 else f"http://{shown}:{port}/"


def describe_address(port: int, *, lan: bool = False, qr: bool = True) -> str:
    """Lines for the terminal: where the page is, in words and as a QR code.

    The address on the network is named only when the service can be reached there.
    """
    url = page_url("127.0.0.1", port)
    lines = [f"Nearfield is at {url}"]
    if not lan:
        lines.append("Only this machine can open it; add --lan to let tablets in.")
        return "\n".join([*lines, *_qr_lines(url, qr)]) + "\n"
    addresses = [address for address in lan_addresses() if ":" not in address] or list(lan_addresses())
    if not addresses:
        lines.append("This machine has no network address; connect it to a network to let tablets in.")
        return "\n".join(lines) + "\n"
    url = page_url(addresses[0], port)
    lines.append(f"Tablets in the same network: {url}")
    return "\n".join([*lines, *_qr_lines(url, qr)]) + "\n"


def _qr_lines(url: str, wanted: bool) -> list[str]:
    if not wanted:
        return []
    code = io.StringIO()
    segno.make(url, error="m").terminal(code, compact=True)
    return [code.getvalue().rstrip("\n")]
