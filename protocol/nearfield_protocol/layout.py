"""Records on the wire as numpy dtypes. Generated from protocol/schema.json by generate.py: do not edit."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np

MAGIC: Final = 0x444C464E
VERSION: Final = 1
SUBPROTOCOL: Final = "nearfield.v1"
MAX_VALS: Final = 64
"""Slots in a light packet."""
MAX_OBJECTS: Final = 256
"""Virtual objects in a light packet or control state."""
MAX_LIGHTS: Final = 256
"""Switchable lights in a control state."""
MAX_CAMERAS: Final = 64
"""Cameras in a status message."""
MAX_SECTIONS: Final = 16
"""Entries of the section table of a light packet."""
MAX_ATLAS_TILES_PER_SIDE: Final = 64
"""Streamed atlas edge in tiles (2048 texels)."""
ATLAS_TILE_SIZE: Final = 32
"""Edge of an atlas tile, texels."""
SH_VALUES: Final = 27
"""Numbers per object: 9 SH coefficients x RGB, coefficient-major."""
NORMAL_STEPS: Final = 2047
"""Octahedral coordinates are integers -2047..2047 over this (12 bit)."""
POSITION_STEPS: Final = 65535
"""Compact positions are integers 0..65535 over this, within the bounds."""
AREA_EXPONENT_BIAS: Final = 40
"""Compact area: 6 bit exponent with this bias, 10 bit mantissa, no sign."""
RGB9E5_EXPONENT_BIAS: Final = 15
"""As in OpenGL's RGB9_E5: 5 bit exponent with this bias, three 9 bit mantissas."""
MAX_CLIENT_MESSAGE_BYTES: Final = 256
"""Longest message that a client may send."""


class MessageType(IntEnum):
    """What a message is. 1..63 go from server to client, 64..127 from client to server."""

    LIGHT_PACKET = 1
    """virtual area lights and SH of every object"""
    ATLAS_TILES = 2
    """changed tiles of the radiance atlas"""
    CONTROL_STATE = 3
    """light weights and object poses that hold now"""
    STATUS = 4
    """heartbeat: server time and ages"""
    ACK = 64
    """a light packet or atlas message has been taken"""
    SUBSCRIBE = 65
    """what the client wants to receive"""
    SET_OBJECT_POSE = 66
    """move a virtual object"""
    SET_LIGHT_WEIGHT = 67
    """dim a switchable light"""


class Encoding(IntEnum):
    """How the VALs and SH of a light packet are written."""

    PLAIN = 0
    """32 bytes per VAL, 108 per object (Rohmer et al. 2014, Section 5)"""
    COMPACT = 1
    """16 bytes per VAL, 54 per object"""


class SectionKind(IntEnum):
    """What a section of a light packet holds."""

    VALS = 1
    """one val_plain or val_compact per slot"""
    OBJECT_SH = 2
    """one object_sh_plain or object_sh_compact per object"""
    OBJECT_STATES = 3
    """one object_state per object"""


class CloseCode(IntEnum):
    """Why a websocket was closed; the reason says it in words that can be shown to users."""

    SHUTTING_DOWN = 1012
    """the service restarts; reconnect"""
    RATE_LIMITED = 1008
    """more control messages per second than allowed"""
    VERSION_MISMATCH = 4001
    """page and server speak different versions; reload the page"""
    MALFORMED_MESSAGE = 4002
    """a message broke the rules of this document"""
    QUEUE_FULL = 4008
    """64 control messages wait to be sent; the client reads too slowly"""
    STALLED = 4009
    """a light packet stayed unacknowledged for too long"""
    SERVER_FULL = 4013
    """as many clients as allowed are connected"""


def _record(size: int, fields: list[tuple[str, str | tuple[str, int], int]]) -> np.dtype[Any]:
    names, formats, offsets = zip(*fields, strict=True)
    return np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": size},
    )


MESSAGE_HEADER = _record(
    16,
    [
        ("magic", "<u4", 0),
        ("version", "<u2", 4),
        ("message_type", "<u2", 6),
        ("sequence", "<u4", 8),
        ("num_bytes", "<u4", 12),
    ],
)
"""Begins every message in both directions."""
LIGHT_PACKET = _record(
    40,
    [
        ("timestamp_ns", "<u8", 0),
        ("room_revision", "<u4", 8),
        ("encoding", "<u1", 12),
        ("num_sections", "<u1", 13),
        ("reserved", "<u2", 14),
        ("bounds_min", ("<f4", 3), 16),
        ("bounds_size", ("<f4", 3), 28),
    ],
)
"""Follows the message header of LIGHT_PACKET; then the section table, then the sections."""
SECTION_ENTRY = _record(
    8,
    [
        ("kind", "<u2", 0),
        ("num_elements", "<u2", 2),
        ("stride", "<u2", 4),
        ("scale_exponent", "<i2", 6),
    ],
)
"""One entry of the section table. Sections follow the table in the same order, each padded with zeros to a multiple of 4 bytes."""
VAL_PLAIN = _record(
    32,
    [
        ("position", ("<f4", 3), 0),
        ("normal", "<u4", 12),
        ("radiant_intensity", ("<f4", 3), 16),
        ("area", "<f4", 28),
    ],
)
"""One virtual area light, PLAIN."""
VAL_COMPACT = _record(
    16,
    [
        ("position", ("<u2", 3), 0),
        ("area", "<u2", 6),
        ("normal", "<u4", 8),
        ("radiant_intensity", "<u4", 12),
    ],
)
"""One virtual area light, COMPACT."""
OBJECT_SH_PLAIN = _record(
    108,
    [
        ("sh_coeffs", ("<f4", 27), 0),
    ],
)
"""SH of the indirect radiance around one object, PLAIN."""
OBJECT_SH_COMPACT = _record(
    54,
    [
        ("sh_coeffs", ("<f2", 27), 0),
    ],
)
"""SH of the indirect radiance around one object, COMPACT."""
OBJECT_STATE = _record(
    4,
    [
        ("pose_revision", "<u4", 0),
    ],
)
"""For which pose an object's SH were taken."""
ATLAS_TILES = _record(
    20,
    [
        ("timestamp_ns", "<u8", 0),
        ("room_revision", "<u4", 8),
        ("width", "<u2", 12),
        ("height", "<u2", 14),
        ("num_tiles", "<u2", 16),
        ("reserved", "<u2", 18),
    ],
)
"""Then num_tiles atlas_tile_position, then as many times 32 x 32 texels (u4, RGB9_E5), row by row, row 0 on top."""
ATLAS_TILE_POSITION = _record(
    4,
    [
        ("column", "<u2", 0),
        ("row", "<u2", 2),
    ],
)
"""Where a tile lies; positions ascend by row, then column, without repeats."""
CONTROL_STATE = _record(
    8,
    [
        ("revision", "<u4", 0),
        ("num_lights", "<u2", 4),
        ("num_objects", "<u2", 6),
    ],
)
"""Follows the message header of CONTROL_STATE; then num_lights weights (f4), then num_objects object_pose."""
OBJECT_POSE = _record(
    32,
    [
        ("pose_revision", "<u4", 0),
        ("position", ("<f4", 3), 4),
        ("quaternion", ("<f4", 4), 16),
    ],
)
"""Where a virtual object stands."""
STATUS = _record(
    16,
    [
        ("server_time_ns", "<u8", 0),
        ("light_age", "<f4", 8),
        ("num_cameras", "<u2", 12),
        ("is_stale", "<u2", 14),
    ],
)
"""Then num_cameras ages (f4, s). An age is +infinity if there was nothing yet, NaN if it is not known."""
ACK = _record(
    8,
    [
        ("acknowledged_sequence", "<u4", 0),
        ("acknowledged_type", "<u2", 4),
        ("reserved", "<u2", 6),
    ],
)
"""Follows the message header of ACK."""
SUBSCRIBE = _record(
    4,
    [
        ("encoding", "<u1", 0),
        ("wants_atlas", "<u1", 1),
        ("reserved", "<u2", 2),
    ],
)
"""Follows the message header of SUBSCRIBE. Before the first one: COMPACT light packets, no atlas."""
SET_OBJECT_POSE = _record(
    32,
    [
        ("object_index", "<u2", 0),
        ("reserved", "<u2", 2),
        ("position", ("<f4", 3), 4),
        ("quaternion", ("<f4", 4), 16),
    ],
)
"""Follows the message header of SET_OBJECT_POSE."""
SET_LIGHT_WEIGHT = _record(
    8,
    [
        ("light_index", "<u2", 0),
        ("reserved", "<u2", 2),
        ("weight", "<f4", 4),
    ],
)
"""Follows the message header of SET_LIGHT_WEIGHT."""
