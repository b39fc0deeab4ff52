"""Half-float pictures as compressed byte planes: what raw recordings hold.

The bytes of a half float are of two kinds: sign, exponent and the top of the mantissa hardly differ from pixel to pixel, the rest is
noise. Put apart (byte shuffle), the first compress well and the second are passed over quickly.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import zstandard
from numba import njit
from numpy.typing import NDArray

from nearfield_server.errors import AssetError

LEVEL: Final = 1
_BYTES: Final = 8  # of a pixel: four halves


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _split(words: Any, planes: Any) -> None:
    """(n,) uint64 to (8, n) uint8: plane b holds byte b of every word."""
    for index in range(words.shape[0]):
        word = words[index]
        for plane in range(_BYTES):
            planes[plane, index] = np.uint8((word >> np.uint64(8 * plane)) & np.uint64(0xFF))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _join(planes: Any, words: Any) -> None:
    """Inverse of `_split`."""
    for index in range(words.shape[0]):
        word = np.uint64(0)
        for plane in range(_BYTES):
            word |= np.uint64(planes[plane, index]) << np.uint64(8 * plane)
        words[index] = word


def split_planes(pixels: NDArray[np.float16]) -> NDArray[np.uint8]:
    """(H, W, 4) float16 to (8, H * W) uint8: plane 2 c + 0 holds the low bytes of channel c, plane 2 c + 1 the high ones."""
    words = np.ascontiguousarray(pixels).view("<u8").reshape(-1)
    planes = np.empty((_BYTES, words.size), np.uint8)
    _split(words, planes)
    return planes


def join_planes(planes: NDArray[np.uint8], height: int, width: int) -> NDArray[np.float16]:
    """Inverse of `split_planes`: (8, H * W) uint8 to (H, W, 4) float16."""
    words = np.empty(height * width, "<u8")
    _join(planes, words)
    return words.view("<f2").reshape(height, width, 4)


def pack_picture(pixels: NDArray[np.float16], level: int = LEVEL) -> bytes:
    """Compress a picture (H, W, 4) float16 without loss; `unpack_picture` gives back the same bits."""
    packer = zstandard.ZstdCompressor(level=level, write_checksum=True, write_content_size=True)
    return packer.compress(split_planes(pixels).data)


def unpack_picture(data: bytes, height: int, width: int, where: str) -> NDArray[np.float16]:
    """Inverse of `pack_picture`.

    Args:
        data: what was packed.
        height: pixels.
        width: pixels.
        where: file and frame, for messages.

    Returns:
        (height, width, 4) float16.

    Raises:
        AssetError: damaged, or of another size; nothing larger than the picture is allocated.
    """
    expected = _BYTES * height * width
    try:
        found = zstandard.frame_content_size(data)
        if found != expected:
            raise AssetError(f"{where}: {found} bytes of pixels, expected {expected} for {width} x {height}")
        planes = zstandard.ZstdDecompressor().decompress(data, max_output_size=expected)
    except zstandard.ZstdError as error:
        raise AssetError(f"{where}: pixels are damaged ({error})") from error
    if len(planes) != expected:
        raise AssetError(f"{where}: pixels end after {len(planes)} bytes, expected {expected}")
    return join_planes(np.frombuffer(planes, np.uint8).reshape(_BYTES, -1), height, width)
