"""Light of any number of lights as ordinary packets.

A packet holds up to 64 lights. More of them are drawn in turns of 64: light adds up, so the picture of all is the unlit picture plus
what each turn adds to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.codec import Encoding, LightPacket, encode_light_packet
from nearfield_server.benchmark.methods.light import MethodLight, no_vals
from nearfield_server.bus.messages import room_revision
from nearfield_server.records import RoomMesh

MAX_LIGHTS: Final = 64
_MARGIN: Final = 1e-3


@dataclass(slots=True)
class MethodPackets:
    """Numbers and writes the packets of one room for one page."""

    mesh: RoomMesh
    sequence: int = 0

    def turns(self, light: MethodLight) -> list[bytes]:
        """Packets of all lights, 64 at a time; the first holds the SH, the others none."""
        starts = range(0, max(len(light.vals), 1), MAX_LIGHTS)
        dark = np.zeros_like(light.object_sh)
        return [
            self._encode(light.vals[start : start + MAX_LIGHTS], light.object_sh if start == 0 else dark)
            for start in starts
        ]

    def dark(self, num_objects: int) -> bytes:
        """A packet without any light."""
        return self._encode(no_vals(), np.zeros((num_objects, 9, 3), np.float32))

    def num_bytes(self, light: MethodLight) -> int:
        """Bytes of all lights in one message; where they need several packets, headers and SH count once."""
        turns = [len(packet) for packet in self.turns(light)]
        return turns[0] + sum(turns[1:]) - (len(turns) - 1) * len(self.dark(len(light.object_sh)))

    def _encode(self, vals: NDArray[np.void], object_sh: NDArray[np.float32]) -> bytes:
        self.sequence += 1
        low, high = self.mesh.positions.min(axis=0), self.mesh.positions.max(axis=0)
        if len(vals):
            # Lights of an environment map stand outside the room.
            low = np.minimum(low, vals["position"].min(axis=0))
            high = np.maximum(high, vals["position"].max(axis=0))
        return encode_light_packet(
            LightPacket(
                sequence=self.sequence,
                timestamp_ns=self.sequence,
                vals=vals,
                object_sh=object_sh,
                object_revisions=np.zeros(len(object_sh), np.uint32),
                bounds_min=(low - _MARGIN).astype(np.float32),
                bounds_size=(high - low + 2.0 * _MARGIN).astype(np.float32),
                room_revision=room_revision(self.mesh.content_hash),
            ),
            Encoding.COMPACT,
        )
