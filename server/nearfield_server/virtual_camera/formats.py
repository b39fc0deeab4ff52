"""Pixel formats as a camera sends them: names and numbers of the GenICam Pixel Format Naming Convention, and codes packed into bytes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class SentFormat:
    """A pixel format that the simulated camera offers.

    Attributes:
        name: of the naming convention.
        number: PFNC value; bits 16 to 23 are the bits per pixel on the wire.
        bits: of one code.
        channels: 1, or 3 for RGB.
        tile: channel of the pixels (0, 0), (0, 1), (1, 0), (1, 1) of a Bayer mosaic (0 red, 1 green, 2 blue); empty otherwise.
        is_packed: codes follow each other without gaps, least significant bit first (suffix "p").
    """

    name: str
    number: int
    bits: int
    channels: int = 1
    tile: tuple[int, ...] = ()
    is_packed: bool = False

    @property
    def wire_bits(self) -> int:
        """Bits per pixel on the wire."""
        return self.number >> 16 & 0xFF

    def num_bytes(self, width: int, height: int) -> int:
        """Bytes of a picture."""
        return width * height * self.wire_bits // 8


_TILES: Final = {"RG": (0, 1, 1, 2), "GR": (1, 0, 2, 1), "GB": (1, 2, 0, 1), "BG": (2, 1, 1, 0)}
_PLAIN: Final = {
    "Mono8": 0x01080001,
    "Mono10": 0x01100003,
    "Mono12": 0x01100005,
    "Mono16": 0x01100007,
    "Mono10p": 0x010A0046,
    "Mono12p": 0x010C0047,
    "RGB8": 0x02180014,
}
_BAYER: Final = {
    "GR": {"8": 0x01080008, "10": 0x0110000C, "12": 0x01100010, "10p": 0x010A0056, "12p": 0x010C0057},
    "RG": {"8": 0x01080009, "10": 0x0110000D, "12": 0x01100011, "10p": 0x010A0058, "12p": 0x010C0059},
    "GB": {"8": 0x0108000A, "10": 0x0110000E, "12": 0x01100012, "10p": 0x010A0054, "12p": 0x010C0055},
    "BG": {"8": 0x0108000B, "10": 0x0110000F, "12": 0x01100013, "10p": 0x010A0052, "12p": 0x010C0053},
}


def _table() -> dict[str, SentFormat]:
    formats = []
    for name, number in _PLAIN.items():
        digits = name.removeprefix("Mono").removeprefix("RGB")
        formats.append(
            SentFormat(
                name=name,
                number=number,
                bits=int(digits.removesuffix("p")),
                channels=3 if name.startswith("RGB") else 1,
                is_packed=digits.endswith("p"),
            )
        )
    for order, numbers in _BAYER.items():
        for digits, number in numbers.items():
            formats.append(
                SentFormat(
                    name=f"Bayer{order}{digits}",
                    number=number,
                    bits=int(digits.removesuffix("p")),
                    tile=_TILES[order],
                    is_packed=digits.endswith("p"),
                )
            )
    return {each.name: each for each in formats}


SENT_FORMATS: Final = _table()


def sent_format(name: str) -> SentFormat:
    """Look a format up.

    Raises:
        ConfigError: the simulated camera has no such format.
    """
    if name not in SENT_FORMATS:
        raise ConfigError(f"pixel format {name!r}: a test camera offers {', '.join(SENT_FORMATS)}")
    return SENT_FORMATS[name]


def sampled(radiance: NDArray[np.float32], pixel_format: SentFormat) -> NDArray[np.float32]:
    """Radiance (H, W, 3) as the photodiodes of a format see it: (H, W), or (H, W, 3) for RGB. Mono sensors see the mean of the channels."""
    if pixel_format.channels == 3:
        return radiance
    if not pixel_format.tile:
        mean: NDArray[np.float32] = radiance.mean(axis=-1, dtype=np.float32)
        return mean
    plane = np.empty(radiance.shape[:2], np.float32)
    for index, channel in enumerate(pixel_format.tile):
        plane[index // 2 :: 2, index % 2 :: 2] = radiance[index // 2 :: 2, index % 2 :: 2, channel]
    return plane


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _pack_12(codes: NDArray[np.uint16], out: NDArray[np.uint8]) -> None:
    """Pairs of 12-bit codes to three bytes, least significant bit first."""
    for pair in range(codes.shape[0] // 2):
        first, second = codes[2 * pair], codes[2 * pair + 1]
        out[3 * pair] = first & 0xFF
        out[3 * pair + 1] = (first >> 8) | ((second & 0xF) << 4)
        out[3 * pair + 2] = second >> 4


def _pack_bits(codes: NDArray[np.uint16], bits: int, out: NDArray[np.uint8]) -> None:
    """Codes of any width, least significant bit first: slow and general."""
    planes = (codes[:, None] >> np.arange(bits, dtype=np.uint16)) & 1
    out[...] = np.packbits(planes.astype(np.uint8).reshape(-1), bitorder="little")


def pack(codes: NDArray[np.uint16], pixel_format: SentFormat, out: NDArray[np.uint8]) -> None:
    """Write codes as the format has them on the wire.

    Args:
        codes: (H, W) or (H, W, 3) uint16, contiguous, below 2^bits.
        pixel_format: their format.
        out: (bytes,) uint8, written completely.
    """
    flat: NDArray[Any] = codes.reshape(-1)
    if pixel_format.is_packed and pixel_format.bits == 12:
        _pack_12(flat, out)
    elif pixel_format.is_packed:
        _pack_bits(flat, pixel_format.bits, out)
    elif pixel_format.bits == 8:
        np.copyto(out, flat, casting="unsafe")
    else:
        np.copyto(out.view("<u2"), flat)
