"""Payload to codes. The kernels work row by row, so that the fast path keeps a row in the nearest cache."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.errors import CaptureError
from nearfield_server.imaging.pixel_formats import Packing, PixelFormat

_BYTES: Final = int(Packing.BYTES)
_WORDS: Final = int(Packing.WORDS)
_LSB: Final = int(Packing.LSB)
_GIGE_VISION: Final = int(Packing.GIGE_VISION)
_MIPI: Final = int(Packing.MIPI)
_UYVY: Final = int(Packing.UYVY)
_JPEG_BEGIN: Final = b"\xff\xd8"
_JPEG_END: Final = b"\xff\xd9"
_JPEG_TAIL: Final = 4096


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _unpack_lsb(data: NDArray[np.uint8], start_bit: int, bits: int, out: NDArray[np.uint16]) -> None:
    """A stream of bits; `start_bit` counts from the first byte."""
    width = out.shape[0]
    first = start_bit >> 3
    done = 0
    if bits == 12 and start_bit & 7 == 0:
        done = width // 2 * 2
        row = data[first : first + done // 2 * 3]
        for pair in range(done // 2):
            low, middle, high = row[3 * pair], row[3 * pair + 1], row[3 * pair + 2]
            out[2 * pair] = np.uint16(low) | np.uint16(middle & 15) << np.uint16(8)
            out[2 * pair + 1] = np.uint16(middle >> 4) | np.uint16(high) << np.uint16(4)
    elif bits == 10 and start_bit & 7 == 0:
        done = width // 4 * 4
        row = data[first : first + done // 4 * 5]
        for four in range(done // 4):
            b0, b1, b2 = np.uint16(row[5 * four]), np.uint16(row[5 * four + 1]), np.uint16(row[5 * four + 2])
            b3, b4 = np.uint16(row[5 * four + 3]), np.uint16(row[5 * four + 4])
            out[4 * four] = b0 | (b1 & np.uint16(3)) << np.uint16(8)
            out[4 * four + 1] = b1 >> np.uint16(2) | (b2 & np.uint16(15)) << np.uint16(6)
            out[4 * four + 2] = b2 >> np.uint16(4) | (b3 & np.uint16(63)) << np.uint16(4)
            out[4 * four + 3] = b3 >> np.uint16(6) | b4 << np.uint16(2)
    mask = (1 << bits) - 1
    for pixel in range(done, width):
        bit = start_bit + pixel * bits
        byte, shift = bit >> 3, bit & 7
        code = np.int64(data[byte])
        if shift + bits > 8:
            code |= np.int64(data[byte + 1]) << 8
        if shift + bits > 16:
            code |= np.int64(data[byte + 2]) << 16
        out[pixel] = np.uint16((code >> shift) & mask)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _unpack_gige_vision(data: NDArray[np.uint8], start: int, bits: int, out: NDArray[np.uint16]) -> None:
    """Pixels `start` and following of the picture, in pairs of three bytes; the last pixel of an odd number takes two bytes."""
    low_bits = bits - 8
    mask = (1 << low_bits) - 1
    done = 0
    if start & 1 == 0:
        pairs = out.shape[0] // 2
        row = data[3 * (start >> 1) : 3 * (start >> 1) + 3 * pairs]
        shift, low = np.uint16(low_bits), np.uint16(mask)
        for pair in range(pairs):
            middle = np.uint16(row[3 * pair + 1])
            out[2 * pair] = np.uint16(row[3 * pair]) << shift | middle & low
            out[2 * pair + 1] = np.uint16(row[3 * pair + 2]) << shift | middle >> np.uint16(4) & low
        done = 2 * pairs
    for pixel in range(done, out.shape[0]):
        place = start + pixel
        base = 3 * (place >> 1)
        odd = place & 1
        out[pixel] = np.uint16(
            np.int64(data[base + 2 * odd]) << low_bits | (np.int64(data[base + 1]) >> (4 * odd)) & mask
        )


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _unpack_mipi(row: NDArray[np.uint8], bits: int, out: NDArray[np.uint16]) -> None:
    """Groups: high bytes, then low bits as a stream."""
    if bits == 12:
        for pair in range(out.shape[0] // 2):
            both = np.uint16(row[3 * pair + 2])
            out[2 * pair] = np.uint16(row[3 * pair]) << np.uint16(4) | both & np.uint16(15)
            out[2 * pair + 1] = np.uint16(row[3 * pair + 1]) << np.uint16(4) | both >> np.uint16(4)
        return
    if bits == 10:
        for four in range(out.shape[0] // 4):
            rest = np.uint16(row[5 * four + 4])
            out[4 * four] = np.uint16(row[5 * four]) << np.uint16(2) | rest & np.uint16(3)
            out[4 * four + 1] = np.uint16(row[5 * four + 1]) << np.uint16(2) | rest >> np.uint16(
                2
            ) & np.uint16(3)
            out[4 * four + 2] = np.uint16(row[5 * four + 2]) << np.uint16(2) | rest >> np.uint16(
                4
            ) & np.uint16(3)
            out[4 * four + 3] = np.uint16(row[5 * four + 3]) << np.uint16(2) | rest >> np.uint16(6)
        return
    low_bits = bits - 8
    group = 2 if bits == 12 else 4
    group_bytes = group * bits // 8
    mask = (1 << low_bits) - 1
    for number in range(out.shape[0] // group):
        base = number * group_bytes
        low = np.int64(0)
        for byte in range(group_bytes - group):
            low |= np.int64(row[base + group + byte]) << (8 * byte)
        for member in range(group):
            out[group * number + member] = np.uint16(
                np.int64(row[base + member]) << low_bits | (low >> (low_bits * member)) & mask
            )


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _unpack_yuv(row: NDArray[np.uint8], is_uyvy: bool, is_limited: bool, out: NDArray[np.uint16]) -> None:
    """4:2:2 to RGB codes by ITU-R BT.601, both pixels of a pair with its chroma; 16-bit fixed point, nearest code."""
    luma_at = 1 if is_uyvy else 0
    chroma_at = 1 - luma_at
    luma_scale = 255.0 / 219.0 if is_limited else 1.0
    chroma_scale = 255.0 / 224.0 if is_limited else 1.0
    gain = np.int64(round(65536 * luma_scale))
    red_v = np.int64(round(65536 * 1.402 * chroma_scale))
    green_u = np.int64(round(65536 * 0.344136286 * chroma_scale))
    green_v = np.int64(round(65536 * 0.714136286 * chroma_scale))
    blue_u = np.int64(round(65536 * 1.772 * chroma_scale))
    foot = np.int64(16) if is_limited else np.int64(0)
    for pair in range(out.shape[0] // 6):
        u = np.int64(row[4 * pair + chroma_at]) - 128
        v = np.int64(row[4 * pair + chroma_at + 2]) - 128
        for member in range(2):
            y = (np.int64(row[4 * pair + luma_at + 2 * member]) - foot) * gain + 32768
            red = (y + red_v * v) >> 16
            green = (y - green_u * u - green_v * v) >> 16
            blue = (y + blue_u * u) >> 16
            base = 6 * pair + 3 * member
            out[base] = np.uint16(min(max(red, np.int64(0)), np.int64(255)))
            out[base + 1] = np.uint16(min(max(green, np.int64(0)), np.int64(255)))
            out[base + 2] = np.uint16(min(max(blue, np.int64(0)), np.int64(255)))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def unpack_row(
    data: NDArray[np.uint8],
    row: int,
    row_bytes: int,
    packing: int,
    bits: int,
    channels: int,
    variant: bool,
    out: NDArray[np.uint16],
) -> None:
    """Codes of one row; the caller has checked the length of `data`.

    Args:
        data: (bytes,) uint8, the payload; of compressed formats the decoded picture.
        row: number of the row.
        row_bytes: from one row to the next; 0 without padding.
        packing: a `Packing`.
        bits: of a code.
        channels: of a pixel.
        variant: BYTES: blue comes first; YUYV and UYVY: limited range.
        out: (width * channels,) uint16, written completely.
    """
    count = out.shape[0]
    if packing == _BYTES:
        first = row * (row_bytes if row_bytes else count)
        source = data[first : first + count]
        if variant:
            for pixel in range(count // 3):
                out[3 * pixel] = source[3 * pixel + 2]
                out[3 * pixel + 1] = source[3 * pixel + 1]
                out[3 * pixel + 2] = source[3 * pixel]
        else:
            for index in range(count):
                out[index] = source[index]
    elif packing == _WORDS:
        first = row * (row_bytes if row_bytes else 2 * count)
        source = data[first : first + 2 * count]
        for index in range(count):
            out[index] = np.uint16(source[2 * index]) | np.uint16(source[2 * index + 1]) << np.uint16(8)
    elif packing == _LSB:
        _unpack_lsb(data, 8 * row * row_bytes if row_bytes else row * count * bits, bits, out)
    elif packing == _GIGE_VISION:
        if row_bytes:
            _unpack_gige_vision(data[row * row_bytes :], 0, bits, out)
        else:
            _unpack_gige_vision(data, row * count, bits, out)
    elif packing == _MIPI:
        first = row * (row_bytes if row_bytes else count * bits // 8)
        _unpack_mipi(data[first : first + count * bits // 8], bits, out)
    else:
        pixels = count // channels
        first = row * (row_bytes if row_bytes else 2 * pixels)
        _unpack_yuv(data[first : first + 2 * pixels], packing == _UYVY, variant, out)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _unpack_rows(
    data: NDArray[np.uint8],
    row_bytes: int,
    packing: int,
    bits: int,
    channels: int,
    variant: bool,
    out: NDArray[np.uint16],
) -> None:
    for row in range(out.shape[0]):
        unpack_row(data, row, row_bytes, packing, bits, channels, variant, out[row])


def decode_jpeg(data: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB of a JPEG picture. Bytes after its end marker are allowed: devices pad.

    Raises:
        CaptureError: no JPEG, cut off, or of another size. A picture that was cut off would decode to a half grey one.
    """
    # Devices pad the payload with zeros.
    tail = data[-_JPEG_TAIL:].tobytes().rstrip(b"\0")
    if data[:2].tobytes() != _JPEG_BEGIN or not tail.endswith(_JPEG_END):
        raise CaptureError(
            f"MJPG: {data.size} bytes that are not a whole JPEG picture; the picture was damaged on its way"
        )
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
    if decoded is None or decoded.shape[:2] != (height, width):
        found = "none" if decoded is None else f"{decoded.shape[1]} x {decoded.shape[0]}"
        raise CaptureError(f"MJPG: expected a picture of {width} x {height} pixels, found {found}")
    return np.asarray(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB), np.uint8)


def check_payload(
    data: NDArray[np.uint8], layout: PixelFormat, width: int, height: int, row_bytes: int
) -> None:
    """Refuse a payload that is too short to be a picture; longer ones are allowed (padding).

    Raises:
        CaptureError: too few bytes, not bytes at all, or rows that do not fit.
    """
    if data.dtype != np.uint8 or data.ndim != 1:
        raise CaptureError(f"{layout.name}: expected bytes, found {data.dtype} of shape {data.shape}")
    expected = layout.payload_bytes(width, height, row_bytes)
    if data.size < expected:
        raise CaptureError(
            f"{layout.name}: a picture of {width} x {height} pixels takes {expected} bytes, found {data.size}; "
            "the device sends another format or size than it was set to, or the picture was cut off"
        )


def plain_rows(
    data: NDArray[np.uint8], layout: PixelFormat, width: int, height: int, row_bytes: int
) -> tuple[NDArray[np.uint8], tuple[int, int, int, int, bool]]:
    """Checked bytes and the arguments (row_bytes, packing, bits, channels, variant) of `unpack_row` for them.

    Raises:
        CaptureError: from `check_payload` and `decode_jpeg`.
    """
    check_payload(data, layout, width, height, row_bytes)
    if layout.packing is Packing.JPEG:
        picture = decode_jpeg(data, width, height)
        return picture.reshape(-1), (0, _BYTES, 8, 3, False)
    variant = layout.is_reversed or layout.is_limited
    if not (data.flags.c_contiguous and data.flags.writeable):
        # Kernels are compiled for one kind of array only.
        data = data.copy()
    return data, (row_bytes, int(layout.packing), layout.bits, layout.channels, variant)


def unpack(
    data: NDArray[np.uint8], layout: PixelFormat, width: int, height: int, row_bytes: int = 0
) -> NDArray[np.uint16]:
    """Codes of a picture.

    Args:
        data: (bytes,) uint8, the payload; may be longer than the picture.
        layout: its format.
        width: pixels.
        height: pixels.
        row_bytes: from one row to the next; 0 without padding.

    Returns:
        (H, W) uint16, or (H, W, 3) red, green, blue.

    Raises:
        CaptureError: the payload is too short, or does not fit the size or the format.
    """
    rows, arguments = plain_rows(data, layout, width, height, row_bytes)
    codes = np.empty((height, width * layout.channels), np.uint16)
    _unpack_rows(rows, *arguments, codes)
    return codes.reshape((height, width, 3) if layout.channels == 3 else (height, width))
