"""From the result of the light pipeline to the bytes of a light packet."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.codec import Encoding, LightPacket, encode_light_packet
from nearfield_protocol.layout import MESSAGE_HEADER
from nearfield_server.bus.messages import room_revision
from nearfield_server.records import LightUpdate, ObjectPose, RoomMesh

_LIGHT_OFFSET: Final = MESSAGE_HEADER.itemsize + 8
"""What follows the message header and the timestamp: the light itself."""


@dataclass(slots=True)
class PacketWriter:
    """Numbers the packets of one room and writes them.

    Light that is the same to the last bit of the wire, however the numbers behind it moved, is no news: the packet stays what it was.

    Attributes:
        bounds_min: (3,) float32, lowest corner of the room. bounds_size: (3,) float32, its edges, > 0.
        room_revision: of the room model.
        sequence: of the newest packet.
    """

    bounds_min: NDArray[np.float32]
    bounds_size: NDArray[np.float32]
    room_revision: int
    sequence: int
    _packet: bytes = b""

    @classmethod
    def for_room(cls, mesh: RoomMesh, first_sequence: int) -> PacketWriter:
        """Start numbering after `first_sequence`; a restarted process must not begin below what clients have seen."""
        low = mesh.positions.min(axis=0).astype(np.float32)
        # Lights lie between surfaces of the room; rounding to float32 must not push one out of the box.
        margin = np.float32(1e-3)
        size = (mesh.positions.max(axis=0) - mesh.positions.min(axis=0)).astype(np.float32) + 2 * margin
        return cls(
            bounds_min=low - margin,
            bounds_size=size,
            room_revision=room_revision(mesh.content_hash),
            sequence=first_sequence & 0xFFFFFFFF,
        )

    def write(self, update: LightUpdate, poses: list[ObjectPose]) -> bytes:
        """Encode one update, compactly; the bytes of the packet before, if a client could not tell the two apart.

        Raises:
            EncodeError: the update holds numbers that no packet can carry; a bug of the pipeline.
        """
        sequence = (self.sequence + 1) & 0xFFFFFFFF
        packet = encode_light_packet(
            LightPacket(
                sequence=sequence,
                timestamp_ns=update.timestamp_ns,
                vals=update.vals,
                object_sh=update.object_sh,
                object_revisions=np.array([pose.revision for pose in poses], np.uint32),
                bounds_min=self.bounds_min,
                bounds_size=self.bounds_size,
                room_revision=self.room_revision,
            ),
            Encoding.COMPACT,
        )
        if packet[_LIGHT_OFFSET:] != self._packet[_LIGHT_OFFSET:]:
            self.sequence, self._packet = sequence, packet
        return self._packet

    def forgetful(self) -> PacketWriter:
        """A writer that goes on counting but knows no packet before: its next packet counts as news."""
        return replace(self, _packet=b"")


@dataclass(slots=True)
class PacketStream:
    """Which packet is in force after each update; the same for a live run and for its replay.

    Attributes:
        writer: numbers and encodes.
        packet: in force; empty before the first update.
        revision: of the update that it was made of.
    """

    writer: PacketWriter
    packet: bytes = b""
    revision: int = 0
    _poses: list[int] = field(default_factory=list)

    def take(self, update: LightUpdate, poses: list[ObjectPose]) -> bytes:
        """Return the packet in force after an update.

        Raises:
            EncodeError: see `PacketWriter.write`.
        """
        revisions = [pose.revision for pose in poses]
        # A moved object may have the same SH as before, but clients wait for the revision of its pose.
        if update.revision != self.revision or revisions != self._poses:
            self.packet = self.writer.write(update, poses)
            self.revision, self._poses = update.revision, revisions
        return self.packet
