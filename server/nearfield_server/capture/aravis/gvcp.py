"""The little of the GigE Vision Control Protocol that is needed before a camera is trusted to libaravis.

Finding cameras, reading registers and memory. Everything that comes from a camera is checked here before it is used; nothing is written
to it, except that control can be given up.
Source: GigE Vision 2.0, chapters 14 to 18 (layout of packets), 28 (bootstrap registers).
"""

from __future__ import annotations

import errno
import ipaddress
import socket
import struct
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Final, Self

from nearfield_server.capture.aravis.library import printable
from nearfield_server.errors import CaptureError

PORT: Final = 3956
DISCOVERY_REPLY_BYTES: Final = 256
LARGEST_READ_BYTES: Final = 512

DISCOVERY: Final = 0x0002
READ_REGISTER: Final = 0x0080
WRITE_REGISTER: Final = 0x0082
READ_MEMORY: Final = 0x0084
PENDING: Final = 0x0089

REGISTER_XML_URL: Final = 0x0200
XML_URL_BYTES: Final = 512
REGISTER_CONTROL: Final = 0x0A00
CONTROL_OR_EXCLUSIVE: Final = 0b11

_HEADER: Final = struct.Struct(">BBHHH")
_REPLY_HEADER: Final = struct.Struct(">HHHH")
_STATUS: Final = {
    0x8001: "not implemented",
    0x8002: "invalid parameter",
    0x8003: "invalid address",
    0x8004: "write protected",
    0x8005: "bad alignment",
    0x8006: "access denied",
    0x8007: "busy",
    0x800F: "packet not yet available",
    0x8FFF: "error",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundCamera:
    """A camera that answered, or that hangs on USB. All texts are printable; they are what the camera says of itself.

    Attributes:
        kind: "gige" or "usb3".
        address: IPv4 address; "" for USB.
        mac: hardware address "00:11:22:aa:bb:cc"; "" for USB.
        vendor: manufacturer. model: model name. serial: serial number. user_name: name that a user has given it.
        interface: network interface on which it was found, or path of the USB device.
        is_reachable: it can be opened as things are.
        advice: what to do where it cannot; "" where it can.
    """

    kind: str
    address: str
    mac: str
    vendor: str
    model: str
    serial: str
    user_name: str
    interface: str
    is_reachable: bool
    advice: str = ""


def encode_command(command: int, payload: bytes, request_id: int, flags: int = 0x01) -> bytes:
    """Bytes of a command; `request_id` is 1 to 65535; flag 1 asks for an answer."""
    return _HEADER.pack(0x42, flags, command, len(payload), request_id) + payload


def decode_reply(packet: bytes, command: int, request_id: int) -> bytes | None:
    """Payload of the answer to a command; None for a packet that answers something else.

    Raises:
        CaptureError: the camera answered that it will not.
    """
    if len(packet) < _REPLY_HEADER.size:
        return None
    status, answered, length, answered_id = _REPLY_HEADER.unpack_from(packet)
    if answered != command + 1 or answered_id != request_id or len(packet) != _REPLY_HEADER.size + length:
        return None
    if status != 0:
        raise CaptureError(f"the camera refused: {_STATUS.get(status, f'status {status:#06x}')}")
    return packet[_REPLY_HEADER.size :]


def decode_discovery(
    packet: bytes, interface: str, subnet: ipaddress.IPv4Network | None
) -> FoundCamera | None:
    """Read the answer to a discovery command.

    Args:
        packet: what was received.
        interface: name of the network interface, for the result.
        subnet: network of that interface; a camera outside cannot be opened. None = not judged.

    Returns:
        The camera; None if the packet is not a whole answer of a GigE Vision device.
    """
    try:
        payload = decode_reply(packet, DISCOVERY, _DISCOVERY_ID)
    except CaptureError:
        return None
    if payload is None or len(packet) != DISCOVERY_REPLY_BYTES:
        return None
    address = ipaddress.IPv4Address(payload[0x24:0x28])
    if address.is_multicast or address.is_reserved:
        return None
    is_reachable = address.packed != bytes(4) and (subnet is None or address in subnet)
    advice = (
        ""
        if is_reachable
        else f"give the camera an address in {subnet} (its own is {address}), or the host one in its network"
    )
    return FoundCamera(
        kind="gige",
        address=str(address),
        mac=":".join(f"{byte:02x}" for byte in payload[0x0A:0x10]),
        vendor=_text(payload[0x48:0x68]),
        model=_text(payload[0x68:0x88]),
        serial=_text(payload[0xD8:0xE8]),
        user_name=_text(payload[0xE8:0xF8]),
        interface=interface,
        is_reachable=is_reachable,
        advice=advice,
    )


_DISCOVERY_ID: Final = 0xFFFF


def discovery_command(*, to_all: bool = True) -> bytes:
    """Ask every GigE Vision device that hears it to describe itself.

    Args:
        to_all: a camera may answer by broadcast (flag 0x10), as one whose network is not the host's must.
    """
    return encode_command(DISCOVERY, b"", _DISCOVERY_ID, flags=0x11 if to_all else 0x01)


def _text(field: bytes) -> str:
    return printable(field.split(b"\0", 1)[0]).strip()


class ControlChannel:
    """A socket to one camera, for reading. Replies are taken from that address and port alone.

    Args:
        address: IPv4 address of the camera.
        timeout_s: wait for an answer; asked three times.
        source: address and port of this machine to ask from; None = any.
    """

    def __init__(self, address: str, timeout_s: float = 0.2, source: tuple[str, int] | None = None) -> None:
        self.address, self._timeout_s = address, timeout_s
        self._request_id = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if source is not None:
                self._socket.bind(source)
            self._socket.connect((address, PORT))
        except OverflowError as error:
            self._socket.close()
            raise CaptureError(f"no port of this machine: {source}") from error
        except OSError as error:
            self._socket.close()
            raise CaptureError(
                f"no way to the camera at {address}: {error.strerror}; check cable, address and network of the host"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    @property
    def host_address(self) -> str:
        """The address of this machine that the camera sees."""
        host: str = self._socket.getsockname()[0]
        return host

    def describe(self) -> FoundCamera:
        """What the camera says of itself; raises CaptureError if nobody or no camera answers."""
        packet = self._exchange(discovery_command(to_all=False), DISCOVERY, _DISCOVERY_ID)
        found = decode_discovery(packet, "", None)
        if found is None:
            raise CaptureError(f"what answers at {self.address} is no GigE Vision camera")
        return found

    def read_register(self, register: int) -> int:
        """Value (32 bit) of a register; raises CaptureError."""
        reply = self._ask(READ_REGISTER, struct.pack(">I", register))
        if len(reply) != 4:
            raise CaptureError(
                f"camera at {self.address}: expected 4 bytes of register {register:#x}, found {len(reply)}"
            )
        return int.from_bytes(reply, "big")

    def read_memory(self, start: int, num_bytes: int, limit_s: float = 5.0) -> bytes:
        """Read memory in pieces; `start` must be divisible by 4.

        Raises:
            CaptureError: no or a wrong answer, or not all of it within `limit_s` seconds.
        """
        pieces = []
        until_s = time.monotonic() + limit_s
        for offset in range(0, num_bytes, LARGEST_READ_BYTES):
            if time.monotonic() > until_s:
                raise CaptureError(
                    f"camera at {self.address}: {num_bytes} bytes of memory took more than {limit_s:g} s"
                )
            count = min(LARGEST_READ_BYTES, (num_bytes - offset + 3) // 4 * 4)
            reply = self._ask(READ_MEMORY, struct.pack(">IHH", start + offset, 0, count))
            if len(reply) != 4 + count or int.from_bytes(reply[:4], "big") != start + offset:
                raise CaptureError(
                    f"camera at {self.address}: wrong answer to a read of {count} bytes at {start + offset:#x}"
                )
            pieces.append(reply[4:])
        return b"".join(pieces)[:num_bytes]

    def give_up_control(self) -> None:
        """Set the camera free; it obeys only if it is controlled from this socket's port, or by nobody. Raises CaptureError."""
        self._ask(WRITE_REGISTER, struct.pack(">II", REGISTER_CONTROL, 0))

    def _ask(self, command: int, payload: bytes) -> bytes:
        self._request_id = self._request_id % 0xFFFE + 1
        packet = self._exchange(encode_command(command, payload, self._request_id), command, self._request_id)
        reply = decode_reply(packet, command, self._request_id)
        assert reply is not None  # _exchange returns nothing else
        return reply

    def _exchange(self, request: bytes, command: int, request_id: int) -> bytes:
        for _ in range(3):
            try:
                self._socket.send(request)
                packet = self._receive(command, request_id)
            except OSError as error:
                if error.errno == errno.ECONNREFUSED:
                    time.sleep(self._timeout_s)  # a host that runs, but no camera on it (yet)
                    continue
                raise CaptureError(f"no way to the camera at {self.address}: {error.strerror}") from error
            if packet is not None:
                return packet
        raise CaptureError(
            f"no camera answers at {self.address}; check power, cable, address and that UDP port {PORT} is not blocked"
        )

    def _receive(self, command: int, request_id: int) -> bytes | None:
        until_s = time.monotonic() + self._timeout_s
        while (left_s := until_s - time.monotonic()) > 0:
            self._socket.settimeout(left_s)
            try:
                packet = self._socket.recv(2048)
            except TimeoutError:
                return None
            if decode_reply(packet, command, request_id) is not None:
                return packet
        return None
