"""Frames survive the way bit for bit; what is no frame is refused in words and costs no memory."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from nearfield_server.capture.remote.messages import (
    Answer,
    FrameEncoder,
    FrameHeader,
    Wish,
    decode_frame,
    largest_frame_bytes,
)
from nearfield_server.capture.remote.tile_planes import join_tiles, pixels_in_tiles, split_tiles, tile_grid
from nearfield_server.errors import CaptureError

sides = st.integers(1, 100)


def _header(words: NDArray[np.uint64], **fields: int) -> FrameHeader:
    height, width = words.shape
    return FrameHeader(
        **{
            "width": width,
            "height": height,
            "session": 7,
            "revision": 3,
            "base": 0,
            "timestamp_ns": -5,
            "confirmed_ns": 9,
            "period_us": 100_000,
            **fields,
        }
    )


def _words(height: int, width: int, seed: int = 0) -> NDArray[np.uint64]:
    return np.random.default_rng(seed).integers(0, 1 << 64, (height, width), np.uint64)


@given(sides, sides, st.integers(0, 2**32), st.sampled_from(["zstd", "none"]))
def test_tiles_arrive_bit_for_bit_and_nothing_else_is_touched(
    height: int, width: int, seed: int, compression: str
) -> None:
    rng = np.random.default_rng(seed)
    words, before = _words(height, width, seed), _words(height, width, seed + 1)
    tiles = rng.random(tile_grid(height, width)) < 0.5
    inside = np.kron(tiles, np.ones((32, 32), bool))[:height, :width]
    assert pixels_in_tiles(tiles, height, width) == inside.sum()
    message = FrameEncoder(compression).encode(_header(words, base=1), tiles, words)
    assert len(message) <= largest_frame_bytes(height, width)
    frame = decode_frame(message, height, width)
    assert frame.header == _header(words, base=1)
    assert np.array_equal(frame.tiles, tiles)
    picture = before.copy()
    frame.paste(picture)
    assert np.array_equal(picture, np.where(inside, words, before))


def test_planes_hold_the_bytes_of_the_pixels_tile_by_tile() -> None:
    words = _words(40, 50)
    chosen = np.array([[False, True], [True, False]])
    planes = split_tiles(words, chosen)
    expected = np.concatenate([words[:32, 32:].reshape(-1), words[32:, :32].reshape(-1)])
    assert np.array_equal(np.ascontiguousarray(planes.T).view(np.uint64)[:, 0], expected)
    with pytest.raises(CaptureError, match="byte planes"):
        join_tiles(planes[:, 1:], chosen, words)
    with pytest.raises(CaptureError, match="byte planes"):
        join_tiles(planes, chosen[:1], words)


def _message(**fields: int) -> bytes:
    words = _words(64, 64)
    tiles = np.ones(tile_grid(64, 64), bool)
    return FrameEncoder("zstd").encode(_header(words, **fields), tiles, words)


@given(st.binary(max_size=400))
def test_noise_is_refused(noise: bytes) -> None:
    for message in (noise, _message()[: len(noise)], b"NFR1" + noise):
        with pytest.raises(CaptureError):
            decode_frame(message, 64, 64)


@given(st.integers(0, 2**32), st.integers(1, 8))
def test_flipped_bits_never_do_more_than_a_refusal_or_another_picture(seed: int, flips: int) -> None:
    rng = np.random.default_rng(seed)
    message = np.frombuffer(_message(), np.uint8).copy()
    # Half of the flips hit the header and the mask, where they hurt most.
    at = np.where(rng.random(flips) < 0.5, rng.integers(0, 80, flips), rng.integers(0, message.size, flips))
    message[at] ^= rng.integers(1, 256, flips, np.uint8)
    try:
        frame = decode_frame(message.tobytes(), 64, 64)
    except CaptureError:
        return
    frame.paste(np.zeros((64, 64), np.uint64))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"width": 32}, "32x64 pixels, but the room file says 64x64"),
        ({"height": 2**31}, "but the room file says"),
        ({"session": 0}, "these cannot be"),
        ({"revision": 0}, "these cannot be"),
        ({"base": 4}, "these cannot be"),
    ],
)
def test_headers_that_cannot_be_are_named(change: dict[str, int], words: str) -> None:
    with pytest.raises(CaptureError, match=words):
        decode_frame(_message(**change), 64, 64)


def test_a_whole_frame_must_be_whole() -> None:
    words = _words(64, 64)
    message = FrameEncoder("none").encode(_header(words), np.array([[True, False], [True, True]]), words)
    with pytest.raises(CaptureError, match="claims to be whole, but 1 of its tiles are missing"):
        decode_frame(message, 64, 64)


def _with_payload(payload: bytes) -> bytes:
    """A whole frame of 64 x 64 pixels with another compressed payload."""
    good = _message()
    header = struct.Struct("<4sBBHIIQQQqqIII")
    fields = list(header.unpack_from(good))
    fields[-1] = len(payload)
    return header.pack(*fields) + good[header.size : header.size + 1] + payload


def test_decompression_bombs_cost_no_memory() -> None:
    gigabytes = 1 << 32
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 26))
    claims = [
        bomb,  # 64 MB of zeros in a few kB, honest about it
        # A header that claims 4 GB, with nothing behind it.
        b"\x28\xb5\x2f\xfd" + bytes([0b11100000]) + struct.pack("<Q", gigabytes) + bytes(8),
        # The right size claimed, but the blocks of the bomb behind it.
        b"\x28\xb5\x2f\xfd" + bytes([0b10100000]) + struct.pack("<I", 64 * 64 * 8) + bomb[10:],
        # No size claimed at all.
        zstandard.ZstdCompressor(write_content_size=False).compress(bytes(64 * 64 * 8)),
        zstandard.ZstdCompressor().compress(bytes(64 * 64 * 8 - 1)),
    ]
    tracemalloc.start()
    try:
        for payload in claims:
            with pytest.raises(CaptureError, match="compressed tiles"):
                decode_frame(_with_payload(payload), 64, 64)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 4_000_000


def test_wishes_and_answers_come_back_equal() -> None:
    wish = Wish(session=2**64 - 1, revision=5, asked_ns=2**62, light_weights=(0.5, 1.0))
    assert Wish.from_json(wish.to_json()) == wish
    answer = Answer(asked_ns=1, received_ns=2, answered_ns=3, fault="cable", source={"kind": "lab"})
    assert Answer.from_json(answer.to_json()) == answer


@pytest.mark.parametrize(
    "message",
    [
        b"",
        b"[]",
        b"{}",
        b"\xff",
        b"[" * 100_000,
        b'{"session": "-1", "revision": "0", "asked_ns": "0", "light_weights": null}',
        b'{"session": "99999999999999999999", "revision": "0", "asked_ns": "0", "light_weights": null}',
        b'{"session": 1, "revision": "0", "asked_ns": "0", "light_weights": null}',
        b'{"session": "1", "revision": "0", "asked_ns": "0", "light_weights": [-1]}',
        b'{"session": "1", "revision": "0", "asked_ns": "0", "light_weights": [NaN]}',
        b'{"asked_ns": "0", "received_ns": "0", "answered_ns": "0", "fault": "", "source": [], "node": {}}',
        b" " * 70_000,
    ],
)
def test_malformed_talk_is_refused(message: bytes) -> None:
    for kind in (Wish, Answer):
        with pytest.raises(CaptureError):
            kind.from_json(message)
