"""The way from GigE Vision cameras to this machine: sockets, buffers, interfaces, filters, ports."""

from __future__ import annotations

import ipaddress
import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from nearfield_server.capture.aravis.receive_buffer import wanted_bytes
from nearfield_server.doctor.finding import Finding, ok, problem, warning
from nearfield_server.doctor.machine import Machine

RMEM_MAX = "/proc/sys/net/core/rmem_max"
SYSCTL_FILE = "/etc/sysctl.d/90-nearfield.conf"
JUMBO_MTU = 8000
_USABLE_SHARE = 0.9  # of a link, after headers and pauses


@dataclass(frozen=True, slots=True, kw_only=True)
class GigeStream:
    """What a GigE camera of the room sends.

    Attributes:
        camera_id: in the room file.
        address: IPv4 address; empty where it is found by its serial number.
        payload: bytes per frame.
        frame_rate: frames per second, all exposures of a bracket counted.
        interface: network interface that the room names; empty where the address leads to one.
    """

    camera_id: str
    address: str
    payload: int
    frame_rate: float
    interface: str = ""

    @property
    def bits_per_s(self) -> float:
        """Without headers."""
        return 8.0 * self.payload * self.frame_rate


def check_packet_socket(machine: Machine) -> Finding:
    """Packets may be read below the IP layer, which makes buffers of the kernel unimportant."""
    if machine.can_open_packet_socket():
        return ok("packet socket", "may be opened: GigE frames bypass the kernel's socket buffers")
    return warning(
        "packet socket",
        "may not be opened (no CAP_NET_RAW): GigE frames come through socket buffers, which costs more and needs `receive buffer`",
        'under systemd: AmbientCapabilities=CAP_NET_RAW; by hand: sudo setcap cap_net_raw+ep "$(readlink -f .venv/bin/python)"',
    )


def check_receive_buffer(machine: Machine, streams: Sequence[GigeStream]) -> Finding:
    """A socket buffer holds a few frames: with room for one, a third of the frames is lost; with the usual 212 kB, nearly all."""
    text = machine.read(RMEM_MAX)
    if text is None or not text.isdecimal():
        return warning("receive buffer", f"{RMEM_MAX} cannot be read", "check that /proc is mounted")
    limit = int(text)
    payload = max((stream.payload for stream in streams), default=0)
    needed = wanted_bytes(payload) if payload else 0
    if limit >= needed:
        told = f" for frames of {payload:,} bytes" if payload else "; no GigE camera in the room"
        return ok("receive buffer", f"up to {limit:,} bytes{told}")
    found = f"up to {limit:,} bytes, expected {needed:,} (frames of {payload:,} bytes)"
    mend = f"echo 'net.core.rmem_max = {needed}' | sudo tee {SYSCTL_FILE} && sudo sysctl --load {SYSCTL_FILE}"
    if machine.can_open_packet_socket():
        return ok("receive buffer", f"{found}; not needed, because packet sockets may be opened")
    return (problem if limit < 2 * payload else warning)(
        "receive buffer", f"{found}: frames will be lost", mend
    )


def check_interfaces(machine: Machine, streams: Sequence[GigeStream]) -> list[Finding]:
    """Every interface towards a GigE camera: way there, link, load, packet size, filters."""
    findings: list[Finding] = []
    by_interface: dict[str, list[GigeStream]] = {}
    for stream in streams:
        interface, is_direct = (
            (stream.interface, True) if stream.interface else interface_towards(machine, stream.address)
        )
        if interface is None or not is_direct:
            findings.append(_no_way(machine, stream, interface))
            continue
        by_interface.setdefault(interface, []).append(stream)
    for interface, using in by_interface.items():
        findings.append(_check_link(machine, interface, using))
        if interface != "lo":
            findings.append(_check_mtu(machine, interface))
            findings.append(_check_reverse_path(machine, interface, using))
    if by_interface:
        findings.append(check_firewall(machine, tuple(by_interface)))
    return findings


def interface_towards(machine: Machine, address: str) -> tuple[str | None, bool]:
    """Interface through which an address is reached, and whether it is in a network of that interface (no router between)."""
    if ipaddress.IPv4Address(address).is_loopback:
        return "lo", True
    best: tuple[int, str | None, bool] = (-1, None, False)
    for network, interface, is_direct in parse_routes(machine.read("/proc/net/route") or ""):
        if ipaddress.IPv4Address(address) in network and network.prefixlen > best[0]:
            best = (network.prefixlen, interface, is_direct)
    return best[1], best[2]


def parse_routes(table: str) -> list[tuple[ipaddress.IPv4Network, str, bool]]:
    """(network, interface, no router between) of every route in /proc/net/route, which holds addresses as little-endian hex."""
    routes = []
    for line in table.splitlines()[1:]:
        fields = line.split()
        if len(fields) < 8:
            continue
        destination, gateway, mask = (
            int.from_bytes(bytes.fromhex(fields[column]), "little") for column in (1, 2, 7)
        )
        network = ipaddress.IPv4Network((destination & mask, mask.bit_count()))
        routes.append((network, fields[0], gateway == 0 and network.prefixlen > 0))
    return routes


def _no_way(machine: Machine, stream: GigeStream, interface: str | None) -> Finding:
    network = ipaddress.IPv4Network((stream.address, 24), strict=False)
    own = next(address for address in network.hosts() if str(address) != stream.address)
    where = (
        "no interface leads there"
        if interface is None
        else f"only the router behind {interface} would lead there"
    )
    candidates = [path.rpartition("/")[2] for path in machine.names("/sys/class/net/*")]
    wired = next((name for name in candidates if name.startswith(("en", "eth"))), "enp3s0")
    return problem(
        f"way to {stream.camera_id}",
        f"{stream.address} is in no network of this machine: {where}",
        f"sudo ip addr add {own}/24 dev {shlex.quote(wired)}   # the interface that the camera is plugged into",
    )


def _check_link(machine: Machine, interface: str, using: Sequence[GigeStream]) -> Finding:
    name = f"link {interface}"
    if interface != "lo" and machine.read(f"/sys/class/net/{interface}/operstate") == "down":
        return problem(
            name, "down", f"sudo ip link set {interface} up   # and check cable, switch and camera power"
        )
    load = sum(stream.bits_per_s for stream in using)
    cameras = ", ".join(stream.camera_id for stream in using)
    told = f"{load / 1e6:,.0f} Mbit/s from {cameras}"
    speed = machine.read(f"/sys/class/net/{interface}/speed")
    if interface == "lo" or speed is None or not speed.isdecimal():
        return ok(name, told)
    capacity = int(speed) * 1e6
    if load > _USABLE_SHARE * capacity:
        share = _USABLE_SHARE * capacity / load
        return problem(
            name,
            f"{told}, but the link carries {int(speed):,} Mbit/s",
            f"lower frame_rate to {share:.2f} of it, use a packed pixel format (12p), or put the cameras on several interfaces",
        )
    if int(speed) < 1000:
        return warning(
            name,
            f"{told} over {speed} Mbit/s: expected 1000",
            "replace the cable by one of category 5e or better",
        )
    return ok(name, f"{told} over {int(speed):,} Mbit/s")


def _check_mtu(machine: Machine, interface: str) -> Finding:
    name = f"packets {interface}"
    text = machine.read(f"/sys/class/net/{interface}/mtu")
    if text is None or not text.isdecimal():
        return warning(name, "the packet size of the interface cannot be read", "check that /sys is mounted")
    if int(text) >= JUMBO_MTU:
        return ok(name, f"up to {int(text):,} bytes")
    return warning(
        name,
        f"up to {int(text):,} bytes: half the processor time is lost, and one lost packet in a thousand breaks most frames",
        f"sudo ip link set dev {interface} mtu 9000   # switch and camera must allow jumbo frames too",
    )


def _check_reverse_path(machine: Machine, interface: str, using: Sequence[GigeStream]) -> Finding:
    name = f"source check {interface}"
    values = [machine.read(f"/proc/sys/net/ipv4/conf/{where}/rp_filter") for where in ("all", interface)]
    # The kernel takes the larger of both; 1 drops packets whose sender would be answered through another interface.
    is_strict = (
        max((int(value) for value in values if value is not None and value.isdecimal()), default=0) == 1
    )
    rivals = {
        other
        for stream in using
        for network, other, is_direct in parse_routes(machine.read("/proc/net/route") or "")
        if is_direct
        and other != interface
        and stream.address
        and ipaddress.IPv4Address(stream.address) in network
    }
    if is_strict and rivals:
        return warning(
            name,
            f"strict, and {', '.join(sorted(rivals))} is in the same network: frames that come in there are dropped",
            f"sudo sysctl -w net.ipv4.conf.{interface}.rp_filter=2   # better: a network of its own for each interface",
        )
    return ok(name, "drops nothing that cameras send")


def check_firewall(machine: Machine, interfaces: Sequence[str]) -> Finding:
    """A firewall that is known to drop what cameras send: frames come to ports that were never asked from."""
    outside = [interface for interface in interfaces if interface != "lo"]
    if not outside:
        return ok("firewall", "cameras are on loopback")
    if "ENABLED=yes" in (machine.read("/etc/ufw/ufw.conf") or ""):
        rules = " && ".join(f"sudo ufw allow in on {interface} proto udp" for interface in outside)
        return warning("firewall", "ufw is on and drops frames unless they are let in", rules)
    if machine.names("/run/firewalld*") or machine.names("/var/run/firewalld*"):
        rules = " && ".join(
            f"sudo firewall-cmd --permanent --zone=trusted --change-interface={interface}"
            for interface in outside
        )
        return warning(
            "firewall",
            "firewalld is on and drops frames unless they are let in",
            f"{rules} && sudo firewall-cmd --reload",
        )
    return ok("firewall", "neither ufw nor firewalld is on")


def check_ports(machine: Machine, port: int, host: str = "127.0.0.1") -> list[Finding]:
    """The port of the page is free, and the message bus can listen on loopback."""
    findings = []
    taken = machine.why_taken(host, port)
    if taken:
        findings.append(
            warning(
                "page port",
                f"{port}: {taken}; a running service, or another program",
                f"sudo ss -ltnp 'sport = :{port}'   # or: nearfield serve ROOM --port {port + 1}",
            )
        )
    else:
        findings.append(ok("page port", f"{port} is free"))
    taken = machine.why_taken("127.0.0.1", 0)
    if taken:
        findings.append(
            problem("bus port", f"no port on loopback can be listened on: {taken}", "sudo ip link set lo up")
        )
    else:
        findings.append(ok("bus port", "loopback has free ports"))
    return findings
