"""Packed pictures: the same bits back, for any bits; damage is told and never costs memory; the encoding is as it is written down."""

from __future__ import annotations

import numcodecs
import numpy as np
import pytest
import xxhash
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from nearfield_server.errors import AssetError
from nearfield_server.recording.files.packed_picture import pack_picture, unpack_picture

_WORDS = hnp.arrays(
    np.uint64, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 2**64 - 1)
)


def _pixels(words: np.ndarray) -> np.ndarray:
    return words.view(np.float16).reshape(*words.shape, 4)


def _packed(pixels: np.ndarray) -> bytes:
    return b"".join(pack_picture(pixels))


def _with_checksum(body: bytes) -> bytes:
    return xxhash.xxh3_64_intdigest(body).to_bytes(8, "little") + body


@given(_WORDS)
def test_any_bits_come_back(words: np.ndarray) -> None:
    height, width = words.shape
    back = unpack_picture(_packed(_pixels(words)), height, width, "test")
    np.testing.assert_array_equal(back.view(np.uint64)[..., 0], words)


def test_large_pictures_of_noise_and_of_one_value_come_back() -> None:
    noise = np.random.default_rng(5).integers(0, 2**16, (333, 517, 4), dtype=np.uint16).view(np.float16)
    for pixels in (noise, np.full_like(noise, 0.25)):
        packed = _packed(pixels)
        assert len(packed) <= pixels.nbytes + 24
        back = unpack_picture(packed, 333, 517, "test")
        np.testing.assert_array_equal(back.view(np.uint16), pixels.view(np.uint16))


@given(_WORDS)
def test_behind_the_checksum_stands_what_any_reader_of_blosc_understands(words: np.ndarray) -> None:
    packed = _packed(_pixels(words))
    assert packed == _with_checksum(packed[8:])
    assert numcodecs.Blosc().decode(packed[8:]) == words.tobytes()


@given(st.data())
def test_no_damage_goes_unnoticed(data: st.DataObject) -> None:
    words = np.arange(48, dtype=np.uint64).reshape(6, 8) * np.uint64(0x9E3779B97F4A7C15)
    packed = bytearray(_packed(_pixels(words)))
    position = data.draw(st.integers(0, len(packed) - 1))
    packed[position] ^= data.draw(st.integers(1, 255))
    cut = data.draw(st.integers(position, len(packed)))
    with pytest.raises(AssetError, match=r"^file: "):
        unpack_picture(bytes(packed[:cut]), 6, 8, "file")


@pytest.mark.parametrize(
    ("sizes", "words"),
    [((50_000_000, 64, 100), "50000000 bytes"), ((128, 64, 10_000), "expected 128"), ((0, 0, 16), "0 bytes")],
)
def test_a_bomb_is_refused_by_its_size(sizes: tuple[int, int, int], words: str) -> None:
    header = bytes([2, 1, 0x24, 8]) + b"".join(size.to_bytes(4, "little") for size in sizes)
    with pytest.raises(AssetError, match=words):
        unpack_picture(_with_checksum(header.ljust(100, b"\0")), 4, 4, "file")


def test_a_forged_body_is_refused() -> None:
    body = bytearray(_packed(_pixels(np.arange(4096, dtype=np.uint64).reshape(64, 64)))[8:])
    body[16:] = b"\xff" * (len(body) - 16)
    with pytest.raises(AssetError, match="cannot be unpacked"):
        unpack_picture(_with_checksum(bytes(body)), 64, 64, "file")
