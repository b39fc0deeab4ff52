"""Hostile bytes: whatever arrives ends in a value or in a typed error."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nearfield_protocol import codec
from nearfield_protocol.errors import (
    BadMagicError,
    DecodeError,
    LimitExceededError,
    TrailingBytesError,
    TruncatedMessageError,
    UnexpectedTypeError,
)

VECTORS = Path(__file__).resolve().parents[2] / "protocol" / "vectors"
DECODERS = [
    codec.decode_light_packet,
    codec.decode_atlas_tiles,
    codec.decode_control_state,
    codec.decode_status,
    codec.decode_client_message,
]
BY_NAME = {
    "light_typical_compact": codec.decode_light_packet,
    "light_special_plain": codec.decode_light_packet,
    "atlas_tiles": codec.decode_atlas_tiles,
    "control_state": codec.decode_control_state,
    "status": codec.decode_status,
    "ack": codec.decode_client_message,
    "subscribe": codec.decode_client_message,
    "set_object_pose": codec.decode_client_message,
    "set_light_weight": codec.decode_client_message,
}


def vector(name: str) -> bytes:
    return (VECTORS / f"{name}.bin").read_bytes()


@given(st.binary(max_size=300))
def test_noise(data: bytes) -> None:
    for decode in DECODERS:
        with pytest.raises(DecodeError):
            decode(data)


@pytest.mark.parametrize("name", list(BY_NAME))
def test_every_truncation(name: str) -> None:
    data = vector(name)
    for length in [*range(min(len(data), 500)), *range(500, len(data), 997)]:
        with pytest.raises(TruncatedMessageError):
            BY_NAME[name](data[:length])
    with pytest.raises((TrailingBytesError, LimitExceededError)):
        BY_NAME[name](data + bytes(1))


@pytest.mark.parametrize("name", list(BY_NAME))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    changes=st.lists(st.tuples(st.integers(0, 399), st.integers(0, 255)), min_size=1, max_size=5),
    cut=st.integers(0, 60),
)
def test_changed_bytes(name: str, changes: list[tuple[int, int]], cut: int) -> None:
    data = bytearray(vector(name))
    for at, value in changes:
        data[at % len(data)] = value
    if cut > 16:
        data = data[:cut]
        data[12:16] = len(data).to_bytes(4, "little")
    with contextlib.suppress(DecodeError):
        BY_NAME[name](bytes(data))


def test_errors_say_where_and_what() -> None:
    data = vector("ack")[:-4]
    with pytest.raises(TruncatedMessageError) as caught:
        codec.decode_client_message(data)
    error = caught.value
    assert (error.offset, error.found) == (len(data), len(data))
    assert str(error) == f"message at byte {len(data)}: expected {len(data) + 4} bytes, found {len(data)}"


def test_magic_type_and_counts() -> None:
    data = bytearray(vector("light_typical_compact"))
    with pytest.raises(UnexpectedTypeError, match="expected ATLAS_TILES, found LIGHT_PACKET"):
        codec.decode_atlas_tiles(bytes(data))
    with pytest.raises(DecodeError, match="at most 256"):
        codec.decode_client_message(bytes(data))
    data[58:60] = (65).to_bytes(2, "little")
    with pytest.raises(LimitExceededError, match="at most 64, found 65"):
        codec.decode_light_packet(bytes(data))
    data[:4] = b"GIF8"
    with pytest.raises(BadMagicError, match="NFLD"):
        codec.decode_light_packet(bytes(data))


def test_unknown_message_type() -> None:
    data = bytearray(vector("ack"))
    data[6:8] = (99).to_bytes(2, "little")
    with pytest.raises(UnexpectedTypeError, match="found 99"):
        codec.peek_header(bytes(data))
