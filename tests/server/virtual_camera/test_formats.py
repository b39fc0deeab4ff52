"""Codes on the wire: every bit is where the convention says."""

from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.errors import ConfigError
from nearfield_server.virtual_camera.formats import SENT_FORMATS, SentFormat, pack, sampled, sent_format


@pytest.mark.parametrize("name", SENT_FORMATS)
def test_the_number_of_a_format_says_how_many_bits_a_pixel_takes(name: str) -> None:
    """PFNC: bits 24 to 31 say mono (1) or colour (2), bits 16 to 23 the bits per pixel."""
    each = SENT_FORMATS[name]
    container = each.bits if each.is_packed else (each.bits + 7) // 8 * 8
    assert each.wire_bits == container * each.channels
    assert each.number >> 24 == (2 if each.channels == 3 else 1)


@pytest.mark.parametrize("name", SENT_FORMATS)
def test_every_bit_of_the_codes_is_on_the_wire_once(name: str) -> None:
    """Read back bit by bit: packed codes follow each other, least significant bit first; others are little-endian."""
    each = sent_format(name)
    rng = np.random.default_rng(1)
    shape = (6, 16) if each.channels == 1 else (6, 16, 3)
    codes = rng.integers(0, 2**each.bits, shape).astype(np.uint16)
    wire = np.zeros(each.num_bytes(16, 6), np.uint8)
    pack(codes, each, wire)
    bits = np.unpackbits(wire, bitorder="little")
    step = each.bits if each.is_packed else each.wire_bits // each.channels
    for index, code in enumerate(codes.reshape(-1).tolist()):
        read = bits[index * step : (index + 1) * step]
        assert sum(int(bit) << place for place, bit in enumerate(read)) == code


@pytest.mark.parametrize("order", ["RG", "GR", "GB", "BG"])
def test_a_mosaic_begins_with_the_two_colours_of_its_name(order: str) -> None:
    radiance = np.zeros((4, 6, 3), np.float32)
    radiance[...] = [1.0, 2.0, 3.0]
    plane = sampled(radiance, sent_format(f"Bayer{order}8"))
    colour = {"R": 1.0, "G": 2.0, "B": 3.0}
    assert plane[0, 0] == colour[order[0]]
    assert plane[0, 1] == colour[order[1]]
    # Every 2 x 2 square has one red, two green, one blue.
    squares = plane.reshape(2, 2, 3, 2).transpose(0, 2, 1, 3).reshape(-1, 4)
    assert np.array_equal(np.sort(squares, axis=1), np.tile([1.0, 2.0, 2.0, 3.0], (6, 1)))


def test_mono_sensors_see_the_mean_and_rgb_sensors_all() -> None:
    radiance = np.array([[[1.0, 2.0, 6.0]]], np.float32)
    assert sampled(radiance, sent_format("Mono12"))[0, 0] == 3.0
    assert np.array_equal(sampled(radiance, sent_format("RGB8")), radiance)


def test_an_unknown_format_is_named() -> None:
    with pytest.raises(ConfigError, match="YUV411"):
        sent_format("YUV411")
    assert isinstance(sent_format("Mono8"), SentFormat)
