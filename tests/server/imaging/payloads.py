"""Codes to payloads, bit by bit, straight from the descriptions of the layouts: the independent half of the tests of unpacking."""

from __future__ import annotations

import numpy as np

from nearfield_server.imaging.pixel_formats import Packing, PixelFormat


def _bits(code: int, first: int, last: int) -> list[int]:
    """Bits `first` to `last` of a code, least significant first."""
    return [(code >> number) & 1 for number in range(first, last + 1)]


def _row_bits(codes: list[int], layout: PixelFormat) -> list[int]:
    """The row as bits, in the order of bytes in memory and, within a byte, from the least significant bit."""
    top = layout.bits - 1
    out: list[int] = []
    if layout.packing is Packing.BYTES:
        pixels = np.array(codes).reshape(-1, layout.channels)
        for pixel in pixels[:, ::-1] if layout.is_reversed else pixels:
            for code in pixel:
                out += _bits(int(code), 0, 7)
    elif layout.packing is Packing.WORDS:
        for code in codes:
            out += _bits(code, 0, 15)
    elif layout.packing is Packing.LSB:
        for code in codes:
            out += _bits(code, 0, top)
    elif layout.packing is Packing.GIGE_VISION:
        low = top - 8
        for index in range(0, len(codes), 2):
            first = codes[index]
            second = codes[index + 1] if index + 1 < len(codes) else None
            out += _bits(first, low + 1, top)
            out += _bits(first, 0, low) + [0] * (3 - low)
            if second is None:
                out += [0] * 4
            else:
                out += _bits(second, 0, low) + [0] * (3 - low) + _bits(second, low + 1, top)
    elif layout.packing is Packing.MIPI:
        low = top - 8
        for index in range(0, len(codes), layout.group):
            group = codes[index : index + layout.group]
            for code in group:
                out += _bits(code, low + 1, top)
            for code in group:
                out += _bits(code, 0, low)
    else:
        raise AssertionError(layout.packing)
    return out


def payload(codes: np.ndarray, layout: PixelFormat, padding: int = 0) -> tuple[np.ndarray, int]:
    """Pack codes (H, W) or (H, W, 3); with `padding` bytes of rubbish after each row. Returns (bytes, row_bytes)."""
    rows = codes.reshape(len(codes), -1).astype(int).tolist()
    if padding == 0:
        if layout.packing is Packing.GIGE_VISION:
            rows = [[code for row in rows for code in row]]
        bits = [bit for row in rows for bit in _row_bits(row, layout)]
        return np.packbits(np.array(bits, np.uint8), bitorder="little"), 0
    packed = [np.packbits(np.array(_row_bits(row, layout), np.uint8), bitorder="little") for row in rows]
    rubbish = np.full(padding, 0xA5, np.uint8)
    whole = np.concatenate([part for row in packed for part in (row, rubbish)])
    return whole, packed[0].size + padding
