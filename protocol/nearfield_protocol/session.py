"""State machines of both ends of a connection: no socket, no clock, no task (SPEC.md, "Flow" and "Handshake").

A server feeds `ServerSession` with what arrives and with what it would like to send, and asks it what to send next. Times are seconds
of any monotonic clock and come from the caller.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.atlas_tiles import AtlasTiles, decode_atlas_tiles, encode_atlas_tiles
from nearfield_protocol.control import (
    Ack,
    ClientMessage,
    ControlState,
    Quaternion,
    SetLightWeight,
    SetObjectPose,
    Status,
    Subscribe,
    Vector3,
    decode_client_message,
    decode_control_state,
    decode_status,
    encode_client_message,
)
from nearfield_protocol.errors import DecodeError, SessionError, UnexpectedTypeError, UnsupportedVersionError
from nearfield_protocol.framing import peek_header
from nearfield_protocol.layout import SUBPROTOCOL, VERSION, CloseCode, Encoding, MessageType
from nearfield_protocol.light_packet import decode_light_packet, encode_light_packet
from nearfield_protocol.light_records import LightPacket

_OUR_SUBPROTOCOL = re.compile(r"nearfield\.v\d{1,6}\Z")
_MAX_REASON_BYTES = 123

ServerMessage = LightPacket | AtlasTiles | ControlState | Status
Tiles = dict[tuple[int, int], NDArray[np.uint32]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Handshake:
    """Answer to a connection: accept it with `subprotocol` (None: refuse), then close it if there is a `close_code`."""

    subprotocol: str | None
    close_code: CloseCode | None = None
    reason: str = ""


def negotiate(offered: Sequence[str]) -> Handshake:
    """Choose among the subprotocols that a client offers."""
    if SUBPROTOCOL in offered:
        return Handshake(subprotocol=SUBPROTOCOL)
    for name in offered:
        if _OUR_SUBPROTOCOL.match(name):
            reason = f"this page speaks {name}, the server {SUBPROTOCOL}: reload the page"
            return Handshake(subprotocol=name, close_code=CloseCode.VERSION_MISMATCH, reason=reason)
    return Handshake(subprotocol=None, reason=f"expected the websocket subprotocol {SUBPROTOCOL}")


def short_reason(reason: str) -> str:
    """The reason, cut to the 123 bytes that a close frame can hold."""
    return reason.encode()[:_MAX_REASON_BYTES].decode(errors="ignore")


class LightOffer:
    """A light packet on its way to many clients; written in another encoding at most once, when the first client wants it.

    Raises:
        DecodeError: The bytes are not a light packet.
    """

    def __init__(self, data: bytes) -> None:
        packet = decode_light_packet(data)
        self._packet = packet
        self.sequence = packet.sequence
        self.timestamp_ns = packet.timestamp_ns
        self.room_revision = packet.room_revision
        self.data = bytes(data)
        self._encoded = {Encoding(data[28]): self.data}

    def encoded(self, encoding: Encoding) -> bytes:
        """The bytes in this encoding."""
        if encoding not in self._encoded:
            self._encoded[encoding] = encode_light_packet(self._packet, encoding)
        return self._encoded[encoding]


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionLimits:
    """Policy of a server.

    Attributes:
        control_queue: control messages that may wait for one client.
        control_rate: client messages per second in the long run. control_burst: at once.
        ack_timeout: seconds after which an unacknowledged light packet closes the connection.
        tiles_per_message: atlas tiles per message.
    """

    control_queue: int = 64
    control_rate: float = 20.0
    control_burst: float = 40.0
    ack_timeout: float = 8.0
    tiles_per_message: int = 4


class ServerSession:
    """The server's end of one connection."""

    def __init__(self, limits: SessionLimits | None = None) -> None:
        self.limits = limits or SessionLimits()
        self.encoding = Encoding.COMPACT
        self.wants_atlas = False
        self.num_light_replaced = 0
        self._light: LightOffer | None = None
        self._control: deque[bytes] = deque()
        self._status: bytes | None = None
        self._tiles: Tiles = {}
        self._atlas: AtlasTiles | None = None
        self._atlas_sequence = 0
        self._in_flight: dict[MessageType, tuple[int, float]] = {}
        self._tokens = self.limits.control_burst
        self._tokens_at: float | None = None

    def receive(self, data: bytes | str, now: float) -> ClientMessage | None:
        """Take a message from the client.

        Returns:
            What the application must act on: a request, or a changed subscription. None for acknowledgements.

        Raises:
            SessionError: The connection must be closed, with this code and reason.
        """
        if isinstance(data, str):
            raise SessionError(CloseCode.MALFORMED_MESSAGE, "expected binary messages, found text")
        try:
            message = decode_client_message(data)
        except UnsupportedVersionError as error:
            reason = f"the page speaks version {error.found}, the server {VERSION}: reload the page"
            raise SessionError(CloseCode.VERSION_MISMATCH, reason) from error
        except DecodeError as error:
            raise SessionError(CloseCode.MALFORMED_MESSAGE, short_reason(str(error))) from error
        if isinstance(message, Ack):
            waiting = self._in_flight.get(message.acknowledged_type)
            if waiting is not None and waiting[0] == message.acknowledged_sequence:
                del self._in_flight[message.acknowledged_type]
                return None
        self._spend_token(now)
        if isinstance(message, Subscribe):
            self.encoding, self.wants_atlas = message.encoding, message.wants_atlas
            if not self.wants_atlas:
                self._tiles.clear()
        return None if isinstance(message, Ack) else message

    def offer_light(self, light: LightOffer) -> None:
        """Send this packet next; a waiting older one is dropped (newest wins)."""
        if self._light is not None:
            self.num_light_replaced += 1
        self._light = light

    def offer_status(self, data: bytes) -> None:
        """Send this status next instead of a waiting one."""
        self._status = data

    def offer_control(self, data: bytes) -> None:
        """Queue a control message; none is ever dropped.

        Raises:
            SessionError: Too many are waiting: the client reads too slowly.
        """
        if len(self._control) >= self.limits.control_queue:
            reason = f"{len(self._control)} control messages wait to be sent: this client reads too slowly"
            raise SessionError(CloseCode.QUEUE_FULL, reason)
        self._control.append(data)

    def offer_atlas(self, tiles: AtlasTiles) -> None:
        """Send these tiles as soon as there is time; newer tiles replace waiting ones at the same place."""
        if not self.wants_atlas:
            return
        previous = self._atlas
        if previous is not None and (previous.width, previous.height, previous.room_revision) != (
            tiles.width,
            tiles.height,
            tiles.room_revision,
        ):
            self._tiles.clear()
        self._atlas = tiles
        for (column, row), texels in zip(tiles.positions.tolist(), tiles.texels, strict=True):
            self._tiles[row, column] = texels

    def next_message(self, now: float) -> bytes | None:
        """What to send now, or None: control before status before light before atlas."""
        if self._control:
            return self._control.popleft()
        if self._status is not None:
            data, self._status = self._status, None
            return data
        if self._light is not None and MessageType.LIGHT_PACKET not in self._in_flight:
            light, self._light = self._light, None
            self._in_flight[MessageType.LIGHT_PACKET] = (light.sequence, now)
            return light.encoded(self.encoding)
        if self._tiles and MessageType.ATLAS_TILES not in self._in_flight:
            return self._next_atlas_message(now)
        return None

    def check(self, now: float) -> None:
        """Look for time-outs; call it about once per second.

        Raises:
            SessionError: A light packet has not been acknowledged in time.
        """
        in_flight = self._in_flight.get(MessageType.LIGHT_PACKET)
        if in_flight is not None and now - in_flight[1] > self.limits.ack_timeout:
            reason = f"no acknowledgement for {self.limits.ack_timeout:g} s: the connection is too slow or the page sleeps"
            raise SessionError(CloseCode.STALLED, reason)

    def _next_atlas_message(self, now: float) -> bytes:
        assert self._atlas is not None
        places = sorted(self._tiles)[: self.limits.tiles_per_message]
        self._atlas_sequence = (self._atlas_sequence + 1) & 0xFFFFFFFF
        self._in_flight[MessageType.ATLAS_TILES] = (self._atlas_sequence, now)
        message = replace(
            self._atlas,
            sequence=self._atlas_sequence,
            positions=np.array([(column, row) for row, column in places], np.uint16),
            texels=np.stack([self._tiles.pop(place) for place in places]),
        )
        return encode_atlas_tiles(message)

    def _spend_token(self, now: float) -> None:
        if self._tokens_at is not None:
            earned = (now - self._tokens_at) * self.limits.control_rate
            self._tokens = min(self._tokens + earned, self.limits.control_burst)
        self._tokens_at = now
        if self._tokens < 1:
            reason = f"more than {self.limits.control_rate:g} control messages per second"
            raise SessionError(CloseCode.RATE_LIMITED, reason)
        self._tokens -= 1


class ClientSession:
    """The client's end of one connection, for tools and tests; tablets have the same in TypeScript."""

    def __init__(self) -> None:
        self._outgoing: list[bytes] = []
        self._sequence = 0

    def receive(self, data: bytes) -> ServerMessage:
        """Take a message from the server; an acknowledgement is queued where one is due.

        Raises:
            DecodeError: The bytes are not a valid message from a server.
        """
        header = peek_header(data)
        match header.message_type:
            case MessageType.LIGHT_PACKET:
                packet = decode_light_packet(data)
                self._acknowledge(header.message_type, header.sequence)
                return packet
            case MessageType.ATLAS_TILES:
                tiles = decode_atlas_tiles(data)
                self._acknowledge(header.message_type, header.sequence)
                return tiles
            case MessageType.CONTROL_STATE:
                return decode_control_state(data)
            case MessageType.STATUS:
                return decode_status(data)
            case other:
                raise UnexpectedTypeError(
                    "message_type", offset=6, expected="a message from a server", found=other.name
                )

    def subscribe(self, *, encoding: Encoding = Encoding.COMPACT, wants_atlas: bool = False) -> None:
        """Say what to receive."""
        self._send(Subscribe(sequence=self._next(), encoding=encoding, wants_atlas=wants_atlas))

    def set_object_pose(self, object_index: int, position: Vector3, quaternion: Quaternion) -> None:
        """Ask to move an object: metres, unit quaternion x, y, z, w."""
        self._send(
            SetObjectPose(
                sequence=self._next(), object_index=object_index, position=position, quaternion=quaternion
            )
        )

    def set_light_weight(self, light_index: int, weight: float) -> None:
        """Ask to dim a light."""
        self._send(SetLightWeight(sequence=self._next(), light_index=light_index, weight=weight))

    def take_outgoing(self) -> list[bytes]:
        """Messages to send, oldest first; they are handed out once."""
        outgoing, self._outgoing = self._outgoing, []
        return outgoing

    def _acknowledge(self, message_type: MessageType, sequence: int) -> None:
        self._send(Ack(sequence=self._next(), acknowledged_type=message_type, acknowledged_sequence=sequence))

    def _next(self) -> int:
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        return self._sequence

    def _send(self, message: ClientMessage) -> None:
        self._outgoing.append(encode_client_message(message))
