"""Names of pixel formats: four-character codes of V4L2, their usual names, and the names that `imaging` knows memory layouts by.

Where a V4L2 layout is one of the EMVA Pixel Format Naming Convention, `SensorFrame.pixel_format` bears that name. Layouts that only V4L2
has keep their V4L2 name: MIPI packing ("SRGGB12P": the high bytes of a group of pixels, then their low bits) is not the packing of
"BayerRG12p".
"""

from __future__ import annotations

from dataclasses import dataclass

from nearfield_server.errors import CaptureError

_PFNC_PHASE = {"RGGB": "RG", "GRBG": "GR", "GBRG": "GB", "BGGR": "BG"}
_BAYER_CODES = {
    # bits: codes of RGGB, GRBG, GBRG, BGGR
    8: ("RGGB", "GRBG", "GBRG", "BA81"),
    10: ("RG10", "BA10", "GB10", "BG10"),
    12: ("RG12", "BA12", "GB12", "BG12"),
    14: ("RG14", "GR14", "GB14", "BG14"),
    16: ("RG16", "GR16", "GB16", "BYR2"),
}
_MIPI_CODES = {
    10: ("pRAA", "pgAA", "pGAA", "pBAA"),
    12: ("pRCC", "pgCC", "pGCC", "pBCC"),
    14: ("pREE", "pgEE", "pGEE", "pBEE"),
}


@dataclass(frozen=True, slots=True)
class V4l2Format:
    """A pixel format.

    Attributes:
        code: four characters, blanks included ("Y10 ").
        usual_name: V4L2_PIX_FMT_... without the prefix ("SRGGB12").
        pixel_format: what `SensorFrame.pixel_format` says ("BayerRG12"); for YUYV and UYVY with luma from 16 to 235.
        bits_per_pixel: in memory; 0 for compressed pictures.
    """

    code: str
    usual_name: str
    pixel_format: str
    bits_per_pixel: int

    @property
    def fourcc(self) -> int:
        """The code as the kernel has it."""
        return fourcc_of(self.code)

    @property
    def is_compressed(self) -> bool:
        """Pictures have no fixed length."""
        return self.bits_per_pixel == 0

    def row_bytes(self, width: int) -> int:
        """Bytes of a row of `width` pixels without padding; 0 where compressed."""
        return -(-width * self.bits_per_pixel // 8)


def _all_formats() -> tuple[V4l2Format, ...]:
    found = [
        V4l2Format("GREY", "GREY", "Mono8", 8),
        V4l2Format("Y10 ", "Y10", "Mono10", 16),
        V4l2Format("Y12 ", "Y12", "Mono12", 16),
        V4l2Format("Y14 ", "Y14", "Mono14", 16),
        V4l2Format("Y16 ", "Y16", "Mono16", 16),
        V4l2Format("Y10P", "Y10P", "Y10P", 10),
        V4l2Format("Y12P", "Y12P", "Y12P", 12),
        V4l2Format("Y14P", "Y14P", "Y14P", 14),
        V4l2Format("RGB3", "RGB24", "RGB8", 24),
        V4l2Format("BGR3", "BGR24", "BGR8", 24),
        V4l2Format("YUYV", "YUYV", "YUYV", 16),
        V4l2Format("UYVY", "UYVY", "UYVY", 16),
        V4l2Format("MJPG", "MJPEG", "MJPG", 0),
        V4l2Format("JPEG", "JPEG", "MJPG", 0),
    ]
    for bits, codes in _BAYER_CODES.items():
        for (phase, pfnc), code in zip(_PFNC_PHASE.items(), codes, strict=True):
            found.append(V4l2Format(code, f"S{phase}{bits}", f"Bayer{pfnc}{bits}", 8 if bits == 8 else 16))
    for bits, codes in _MIPI_CODES.items():
        for phase, code in zip(_PFNC_PHASE, codes, strict=True):
            found.append(V4l2Format(code, f"S{phase}{bits}P", f"S{phase}{bits}P", bits))
    return tuple(found)


FORMATS: tuple[V4l2Format, ...] = _all_formats()
_BY_CODE = {known.code: known for known in FORMATS}
_BY_NAME = {
    **{known.pixel_format.upper(): known for known in reversed(FORMATS)},
    **{known.usual_name.upper(): known for known in FORMATS},
}


def fourcc_of(code: str) -> int:
    """Return the number of a four-character code; shorter ones are filled with blanks."""
    return int.from_bytes(code.ljust(4).encode("ascii"), "little")


def code_of(fourcc: int) -> str:
    """Return the four characters of a number; a big-endian format (bit 31) gets "-BE" as the kernel prints it."""
    raw = (fourcc & 0x7FFF_FFFF).to_bytes(4, "little")
    code = "".join(chr(byte) if 0x20 <= byte < 0x7F else "?" for byte in raw)
    return f"{code}-BE" if fourcc & 0x8000_0000 else code


def find_code(code: str) -> V4l2Format | None:
    """Return the format of a four-character code, None if `imaging` has no use for it."""
    return _BY_CODE.get(code)


def find_format(name: str) -> V4l2Format:
    """Return the format that a room file means: code ("RG12"), usual name ("SRGGB12") or name in the frame ("BayerRG12").

    Raises:
        CaptureError: no such format; lists those that there are.
    """
    found = _BY_CODE.get(name.ljust(4)) or _BY_NAME.get(name.upper().removeprefix("V4L2_PIX_FMT_"))
    if found is None:
        known = ", ".join(entry.usual_name for entry in FORMATS)
        raise CaptureError(f"pixel_format: expected a V4L2 format, found '{name}'; known are: {known}")
    return found
