from __future__ import annotations

import pytest

from nearfield_server.capture.v4l2.formats import (
    FORMATS,
    V4l2Format,
    code_of,
    find_code,
    find_format,
    fourcc_of,
)
from nearfield_server.errors import CaptureError
from nearfield_server.imaging.pixel_formats import pixel_format

# From the section "Image Formats" of the Linux Media User Space API: code, name there, and what it is by PFNC where PFNC has it.
DOCUMENTED = [
    ("GREY", "GREY", "Mono8"),
    ("Y10 ", "Y10", "Mono10"),
    ("Y16 ", "Y16", "Mono16"),
    ("BA81", "SBGGR8", "BayerBG8"),
    ("GRBG", "SGRBG8", "BayerGR8"),
    ("BA10", "SGRBG10", "BayerGR10"),
    ("RG12", "SRGGB12", "BayerRG12"),
    ("GB14", "SGBRG14", "BayerGB14"),
    ("BYR2", "SBGGR16", "BayerBG16"),
    ("pgAA", "SGRBG10P", "SGRBG10P"),
    ("pRCC", "SRGGB12P", "SRGGB12P"),
    ("RGB3", "RGB24", "RGB8"),
    ("MJPG", "MJPEG", "MJPG"),
]


@pytest.mark.parametrize(("code", "usual", "name"), DOCUMENTED)
def test_documented_formats_have_their_names(code: str, usual: str, name: str) -> None:
    for spelling in (code, code.strip(), usual, f"V4L2_PIX_FMT_{usual}", usual.lower()):
        assert find_format(spelling).code == code
    assert find_format(code).pixel_format == name
    assert find_code(code_of(fourcc_of(code))) == find_format(code)


def test_codes_and_usual_names_are_unique() -> None:
    assert len({known.code for known in FORMATS}) == len(FORMATS)
    assert len({known.usual_name for known in FORMATS}) == len(FORMATS)


def test_the_number_of_a_code_has_its_first_character_lowest() -> None:
    assert fourcc_of("YUYV") == ord("Y") | ord("U") << 8 | ord("Y") << 16 | ord("V") << 24
    assert code_of(fourcc_of("Y16 ") | 1 << 31) == "Y16 -BE"
    assert find_code("Y16 -BE") is None


def test_rows_of_packed_formats_round_up_to_whole_bytes() -> None:
    # MIPI RAW10: five bytes hold four pixels; RAW12: three hold two; RAW14: seven hold four.
    assert [find_format(name).row_bytes(8) for name in ("SRGGB10P", "SRGGB12P", "SRGGB14P")] == [10, 12, 14]
    assert find_format("SRGGB10P").row_bytes(5) == 7
    assert find_format("MJPG").row_bytes(640) == 0


@pytest.mark.parametrize("known", FORMATS, ids=lambda known: known.usual_name)
def test_every_format_can_be_unpacked_with_the_same_layout(known: V4l2Format) -> None:
    layout = pixel_format(known.pixel_format)
    assert layout.pixel_bits == known.bits_per_pixel
    digits = "".join(filter(str.isdigit, known.usual_name.removesuffix("24")))
    assert layout.bits == int(digits or 8)
    phase = known.usual_name[1:5]
    assert layout.bayer == (phase if sorted(phase) == sorted("RGGB") else None)
    if not known.is_compressed:
        row_bytes = known.row_bytes(32)
        assert layout.payload_bytes(32, 8, row_bytes) == layout.payload_bytes(32, 8) == 8 * row_bytes


def test_an_unknown_format_lists_the_known_ones() -> None:
    with pytest.raises(CaptureError, match=r"found 'H264'; known are: GREY, .*SRGGB12P"):
        find_format("H264")
