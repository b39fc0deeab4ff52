"""Every message of the protocol, to bytes and back: the names that other packages use."""

from nearfield_protocol.atlas_tiles import (
    AtlasTiles,
    cut_tiles,
    decode_atlas_tiles,
    decode_radiance,
    encode_atlas_tiles,
    encode_radiance,
    paste_tiles,
    tile_changes,
)
from nearfield_protocol.control import (
    Ack,
    ClientMessage,
    ControlState,
    SetLightWeight,
    SetObjectPose,
    Status,
    Subscribe,
    WirePose,
    decode_client_message,
    decode_control_state,
    decode_status,
    encode_client_message,
    encode_control_state,
    encode_status,
)
from nearfield_protocol.framing import Header, peek_header
from nearfield_protocol.layout import SUBPROTOCOL, VERSION, CloseCode, Encoding, MessageType
from nearfield_protocol.light_packet import decode_light_packet, encode_light_packet
from nearfield_protocol.light_records import VAL_DTYPE, LightPacket, empty_vals

__all__ = [
    "SUBPROTOCOL",
    "VAL_DTYPE",
    "VERSION",
    "Ack",
    "AtlasTiles",
    "ClientMessage",
    "CloseCode",
    "ControlState",
    "Encoding",
    "Header",
    "LightPacket",
    "MessageType",
    "SetLightWeight",
    "SetObjectPose",
    "Status",
    "Subscribe",
    "WirePose",
    "cut_tiles",
    "decode_atlas_tiles",
    "decode_client_message",
    "decode_control_state",
    "decode_light_packet",
    "decode_radiance",
    "decode_status",
    "empty_vals",
    "encode_atlas_tiles",
    "encode_client_message",
    "encode_control_state",
    "encode_light_packet",
    "encode_radiance",
    "encode_status",
    "paste_tiles",
    "peek_header",
    "tile_changes",
]
