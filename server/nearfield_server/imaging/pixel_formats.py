"""Pixel formats: what a byte of a payload means.

Names are those of the EMVA Pixel Format Naming Convention (PFNC) where it has the layout. The layouts that only Video4Linux has keep its
names: "SRGGB12P" (MIPI CSI-2 packing) is another packing than "BayerRG12p". Compressed pictures are "MJPG".
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, unique
from typing import Final

from nearfield_server.errors import CaptureError


@unique
class Packing(IntEnum):
    """How codes lie in memory; numbers, because kernels branch on them."""

    BYTES = 0
    """One code per byte; several channels follow each other within a pixel."""
    WORDS = 1
    """One code per little-endian 16-bit word, in its lower bits."""
    LSB = 2
    """PFNC "p": a stream of bits, least significant first, without gaps; also from row to row where rows have no padding."""
    GIGE_VISION = 3
    """GigE Vision 1.x "Packed": two codes in three bytes: high byte, low bits of both, high byte."""
    MIPI = 4
    """CSI-2: the high bytes of a group of codes, then their low bits as a stream, least significant first."""
    YUYV = 5
    """4:2:2, two pixels in four bytes: Y U Y V."""
    UYVY = 6
    """4:2:2, two pixels in four bytes: U Y V Y."""
    JPEG = 7
    """A JPEG file per picture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelFormat:
    """A pixel format.

    Attributes:
        name: see the module.
        bits: of a code, as `unpack` returns it.
        bayer: colours of the pixels (0, 0), (0, 1), (1, 0), (1, 1): "RGGB", "GRBG", "GBRG" or "BGGR"; None without a mosaic.
        channels: of a pixel, as `unpack` returns it: 1, or 3 (red, green, blue).
        packing: layout in memory.
        is_reversed: channels lie in memory as blue, green, red.
        is_limited: luma and chroma use 16 to 235 and 16 to 240 (ITU-R BT.601); else the whole byte.
    """

    name: str
    bits: int
    bayer: str | None = None
    channels: int = 1
    packing: Packing
    is_reversed: bool = False
    is_limited: bool = False

    @property
    def is_video(self) -> bool:
        """Codes were made for a display (YUV, JPEG): proportional to light only after a curve is undone."""
        return self.packing in (Packing.YUYV, Packing.UYVY, Packing.JPEG)

    @property
    def top_code(self) -> int:
        """The largest code."""
        return (1 << self.bits) - 1

    @property
    def pixel_bits(self) -> int:
        """Bits of a pixel in memory; 0 where compressed. Groups of pixels are whole: see `group`."""
        if self.packing is Packing.JPEG:
            return 0
        if self.packing is Packing.BYTES:
            return 8 * self.channels
        if self.packing in (Packing.WORDS, Packing.YUYV, Packing.UYVY):
            return 16
        return 12 if self.packing is Packing.GIGE_VISION else self.bits

    @property
    def group(self) -> int:
        """Pixels that share bytes: a row of MIPI or YUV pictures consists of whole groups, as does a picture of legacy packing."""
        if self.packing is Packing.MIPI:
            return 2 if self.bits == 12 else 4
        return 2 if self.packing in (Packing.GIGE_VISION, Packing.YUYV, Packing.UYVY) else 1

    def payload_bytes(self, width: int, height: int, row_bytes: int = 0) -> int:
        """Least number of bytes of a picture; padding after the last row is not needed. 0 where compressed.

        Raises:
            CaptureError: rows are longer than `row_bytes`, or the width is no multiple of the group.
        """
        if self.packing is Packing.JPEG:
            return 0
        row_bits = self.pixel_bits * width
        if width % self.group and self.packing is not Packing.GIGE_VISION:
            raise CaptureError(
                f"{self.name}: expected a width that is a multiple of {self.group}, found {width}"
            )
        if self.packing is Packing.GIGE_VISION and row_bytes:
            row_bits = 24 * -(-width // 2)
        if row_bytes == 0:
            # Legacy packing puts a last odd pixel into two bytes.
            return -(-row_bits * height // 8)
        if 8 * row_bytes < row_bits:
            raise CaptureError(
                f"{self.name}: a row of {width} pixels takes {-(-row_bits // 8)} bytes, found row_bytes = {row_bytes}"
            )
        return row_bytes * (height - 1) + -(-row_bits // 8)


_PHASES: Final = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}


def _all_formats() -> dict[str, PixelFormat]:
    found: list[PixelFormat] = []

    def add(name: str, bits: int, packing: Packing, bayer: str | None = None) -> None:
        found.append(PixelFormat(name=name, bits=bits, packing=packing, bayer=bayer))

    for stem, bayer in {"Mono": None, **{f"Bayer{pair}": phase for pair, phase in _PHASES.items()}}.items():
        add(f"{stem}8", 8, Packing.BYTES, bayer)
        for bits in (10, 12, 14, 16):
            add(f"{stem}{bits}", bits, Packing.WORDS, bayer)
        for bits in (10, 12, 14):
            add(f"{stem}{bits}p", bits, Packing.LSB, bayer)
        for bits in (10, 12):
            add(f"{stem}{bits}Packed", bits, Packing.GIGE_VISION, bayer)
        for bits in (10, 12, 14):
            add(f"S{bayer}{bits}P" if bayer else f"Y{bits}P", bits, Packing.MIPI, bayer)
    found += [
        PixelFormat(name="RGB8", bits=8, channels=3, packing=Packing.BYTES),
        PixelFormat(name="BGR8", bits=8, channels=3, packing=Packing.BYTES, is_reversed=True),
        PixelFormat(name="MJPG", bits=8, channels=3, packing=Packing.JPEG),
    ]
    for name, packing, is_limited in (
        ("YUYV", Packing.YUYV, True),
        ("UYVY", Packing.UYVY, True),
        ("YUV422_8", Packing.YUYV, False),
        ("YUV422_8_UYVY", Packing.UYVY, False),
        ("YCbCr422_8", Packing.YUYV, False),
        ("YCbCr601_422_8", Packing.YUYV, True),
    ):
        found.append(PixelFormat(name=name, bits=8, channels=3, packing=packing, is_limited=is_limited))
    return {each.name: each for each in found}


FORMATS: Final[dict[str, PixelFormat]] = _all_formats()
"""By name."""


def pixel_format(name: str) -> PixelFormat:
    """Look a format up.

    Raises:
        CaptureError: its layout is not known.
    """
    found = FORMATS.get(name)
    if found is None:
        raise CaptureError(
            f'pixel format "{name}": cannot be read; set pixel_format to one of {", ".join(FORMATS)}'
        )
    return found
