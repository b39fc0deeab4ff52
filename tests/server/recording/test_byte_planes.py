"""Byte planes: the same bits back, for any bits; damage is told and never costs memory."""

from __future__ import annotations

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from nearfield_server.errors import AssetError
from nearfield_server.recording.files.byte_planes import (
    join_planes,
    pack_picture,
    split_planes,
    unpack_picture,
)

_WORDS = hnp.arrays(
    np.uint64, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 2**64 - 1)
)


def _pixels(words: np.ndarray) -> np.ndarray:
    return words.view(np.float16).reshape(*words.shape, 4)


@given(_WORDS)
def test_any_bits_come_back_through_planes_and_compression(words: np.ndarray) -> None:
    pixels = _pixels(words)
    height, width = words.shape
    for back in (
        join_planes(split_planes(pixels), height, width),
        unpack_picture(pack_picture(pixels), height, width, "test"),
    ):
        np.testing.assert_array_equal(back.view(np.uint64)[..., 0], words)


@given(_WORDS)
def test_plane_b_holds_byte_b_of_every_pixel(words: np.ndarray) -> None:
    expected = np.moveaxis(words.view(np.uint8).reshape(-1, 8), 0, 1)
    np.testing.assert_array_equal(split_planes(_pixels(words)), expected)


@given(st.data())
def test_no_damage_goes_unnoticed(data: st.DataObject) -> None:
    words = np.arange(48, dtype=np.uint64).reshape(6, 8) * np.uint64(0x9E3779B97F4A7C15)
    packed = bytearray(pack_picture(_pixels(words)))
    position = data.draw(st.integers(0, len(packed) - 1))
    packed[position] ^= data.draw(st.integers(1, 255))
    cut = data.draw(st.integers(position, len(packed)))
    try:
        back = unpack_picture(bytes(packed[:cut]), 6, 8, "file")
    except AssetError:
        return
    # A bit that means nothing.
    np.testing.assert_array_equal(back.view(np.uint64)[..., 0], words)


def test_a_bomb_is_refused_by_its_size() -> None:
    bomb = zstandard.ZstdCompressor().compress(bytes(50_000_000))
    assert len(bomb) < 10_000
    with pytest.raises(AssetError, match="50000000 bytes"):
        unpack_picture(bomb, 4, 4, "file")
    nameless = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(128))
    with pytest.raises(AssetError, match="expected 128"):
        unpack_picture(nameless, 4, 4, "file")
