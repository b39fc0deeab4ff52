"""From the result of the light pipeline to the bytes of a light packet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.codec import Encoding, LightPacket, encode_light_packet
from nearfield_server.bus.messages import room_revision
from nearfield_server.records import LightUpdate, ObjectPose, RoomMesh


@dataclass(slots=True)
class PacketWriter:
    """Numbers the packets of one room and writes them.

    Attributes:
        bounds_min: (3,) float32, lowest corner of the room. bounds_size: (3,) float32, its edges, > 0.
        room_revision: of the room model.
        sequence: of the newest packet.
    """

    bounds_min: NDArray[np.float32]
    bounds_size: NDArray[np.float32]
    room_revision: int
    sequence: int

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
        """Encode one update, compactly.

        Raises:
            EncodeError: the update holds numbers that no packet can carry; a bug of the pipeline.
        """
        self.sequence = (self.sequence + 1) & 0xFFFFFFFF
        return encode_light_packet(
            LightPacket(
                sequence=self.sequence,
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
