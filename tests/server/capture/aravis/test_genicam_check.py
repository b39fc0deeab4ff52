"""Descriptions of cameras are judged before anyone believes them: size, archive, circles, explosions."""

import contextlib
import io
import zipfile

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from tests.server.capture.aravis.gige_camera import describe

from nearfield_server.capture.aravis import genicam_check
from nearfield_server.capture.aravis.genicam_check import (
    LARGEST_ARCHIVE_BYTES,
    LARGEST_XML_BYTES,
    LONGEST_CHAIN,
    MOST_READS,
    check_genicam,
    parse_genicam_url,
    unpack_genicam,
)
from nearfield_server.errors import CaptureError


def description(body: str) -> bytes:
    return f"<RegisterDescription>{body}</RegisterDescription>".encode()


def chain(length: int, links: int = 1) -> bytes:
    """Nodes N0 to N(length - 1), of which each reads the next one `links` times."""
    nodes = [
        f'<IntSwissKnife Name="N{index}">'
        + "".join(f'<pVariable Name="V{link}">N{index + 1}</pVariable>' for link in range(links))
        + "<Formula>V0</Formula></IntSwissKnife>"
        for index in range(length - 1)
    ]
    return description("".join(nodes) + f'<Integer Name="N{length - 1}"><Value>1</Value></Integer>')


def archive(content: bytes, count: int = 1) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as opened:
        for index in range(count):
            opened.writestr(f"camera{index}.xml", content)
    return packed.getvalue()


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        (b"Local:camera.zip;F0000000;3E67", ("camera.zip", 0xF0000000, 0x3E67)),
        (b"local:///camera.xml;100;20?SchemaVersion=1.1.0", ("camera.xml", 0x100, 0x20)),
    ],
)
def test_places_in_the_camera_are_read(url: bytes, expected: tuple[str, int, int]) -> None:
    assert parse_genicam_url(url) == expected


@pytest.mark.parametrize(
    "url",
    [
        *(
            b"",
            b"File:///etc/passwd",
            b"http://127.0.0.1/a.xml",
            b"smb://host/a;0;1",
            b"Local:a.xml",
            b"Local:a.xml;x;y",
        ),
        *(
            b"Local:a.xml;0;0",
            b"Local:a.xml;1;10",
            b"Local:a.xml;fffffff0;20",
            b"Local:a.xml;0;%x" % (LARGEST_ARCHIVE_BYTES + 1),
        ),
        *(b"Local:a.xml;-4;10", b"Local:a.xml;0;10\n;0;1", b"Local:a.xml;0;ffffffffffffffffffff"),
    ],
)
def test_other_places_are_refused(url: bytes) -> None:
    with pytest.raises(CaptureError, match=r"expected .* found"):
        parse_genicam_url(url)


@given(st.binary(max_size=300))
def test_any_url_is_read_or_refused(url: bytes) -> None:
    try:
        _, address, num_bytes = parse_genicam_url(url)
    except CaptureError as refusal:
        words = str(refusal)
    else:
        words = ""
        assert 0 < num_bytes <= LARGEST_ARCHIVE_BYTES
        assert address + num_bytes <= 1 << 32
    assert words.isprintable() or words == ""


def test_an_archive_of_one_file_is_unpacked() -> None:
    assert unpack_genicam(archive(describe())) == describe()


@pytest.mark.parametrize(
    ("packed", "message"),
    [
        (archive(b"x", count=2), "found 2 of"),
        (archive(b"x", count=0), "found 0 of"),
        (b"PK\x03\x04 nothing", "damaged"),
        (archive(describe())[:-40], "damaged"),
        (archive(describe()).replace(b"camera0", b"camera1", 1), "damaged"),
    ],
)
def test_other_archives_are_refused(packed: bytes, message: str) -> None:
    with pytest.raises(CaptureError, match=message):
        unpack_genicam(packed)


def test_an_archive_that_unfolds_too_far_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(genicam_check, "LARGEST_XML_BYTES", 1000)
    assert len(unpack_genicam(archive(bytes(1000)))) == 1000
    with pytest.raises(CaptureError, match="at most 1000 bytes"):
        unpack_genicam(archive(bytes(1001)))


def test_an_archive_that_lies_about_its_size_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    packed = archive(bytes(1001))
    lying = packed.replace((1001).to_bytes(4, "little"), (999).to_bytes(4, "little"))
    assert lying != packed
    monkeypatch.setattr(genicam_check, "LARGEST_XML_BYTES", 1000)
    with pytest.raises(CaptureError):
        unpack_genicam(lying)


@given(st.binary(max_size=200), st.integers(0, 400))
def test_damaged_archives_raise_only_our_error(noise: bytes, place: int) -> None:
    packed = bytearray(archive(describe()))
    packed[place : place + len(noise)] = noise
    with contextlib.suppress(CaptureError):
        assert len(unpack_genicam(bytes(packed))) <= LARGEST_XML_BYTES


def test_a_sound_description_passes() -> None:
    summary = check_genicam(describe())
    assert {"Width", "ExposureTime", "PixelFormat"} <= summary.names
    assert 2 <= summary.longest_chain <= 4
    assert check_genicam(describe() + b"\0\0").names == summary.names  # cameras pad with zeros


@pytest.mark.parametrize("length", [1, 2, LONGEST_CHAIN])
def test_chains_up_to_the_limit_pass(length: int) -> None:
    summary = check_genicam(chain(length))
    assert (summary.longest_chain, summary.most_reads) == (
        length if length > 1 else 0,
        length if length > 1 else 0,
    )


def test_reads_are_counted_with_repetition() -> None:
    assert check_genicam(chain(8, links=2)).most_reads == 2**8 - 1


@pytest.mark.parametrize(
    ("xml", "message"),
    [
        (chain(LONGEST_CHAIN + 1), "levels"),
        (chain(40, links=2), f"{MOST_READS}"),
        (chain(2_000), "levels"),
        (description('<Integer Name="A"><pValue>A</pValue></Integer>'), "from itself"),
        (
            description(
                '<IntReg Name="A"><pAddress>B</pAddress></IntReg><Integer Name="B"><pValue>A</pValue></Integer>'
            ),
            "from itself",
        ),
        (description('<IntReg Name="A"><pIndex pOffset="A">B</pIndex></IntReg>'), "from itself"),
        (
            description(
                '<IntReg Name="A"><IntSwissKnife Name="B"><pVariable Name="X">A</pVariable></IntSwissKnife></IntReg>'
            ),
            "from itself",
        ),
        (
            description(f'<SwissKnife Name="A"><Formula>{"1+" * 10_000}1</Formula></SwissKnife>'),
            "formulas of at most",
        ),
        (description('<StringReg Name="A"><Length>4294967296</Length></StringReg>'), "registers of at most"),
        (description('<StringReg Name="A"><Length>-1</Length></StringReg>'), "registers of at most"),
        (description("<Group>" * 100 + "</Group>" * 100), "nested"),
        (b"<html/>", "RegisterDescription"),
        (b"", "no XML"),
        (b"<RegisterDescription>", "no XML"),
        (b'<?xml version="1.0" encoding="utf-7"?><RegisterDescription/>', r"no XML|UTF-8"),
        (
            b'<!DOCTYPE RegisterDescription SYSTEM "file:///etc/passwd"><RegisterDescription/>',
            "document type",
        ),
        (
            b'<!DOCTYPE x [<!ENTITY a "&#97;">]><RegisterDescription>&a;</RegisterDescription>',
            "document type",
        ),
    ],
)
def test_what_could_harm_is_refused(xml: bytes, message: str) -> None:
    with pytest.raises(CaptureError, match=message) as caught:
        check_genicam(xml)
    assert str(caught.value).isprintable()


def test_entries_of_enumerations_may_have_names_of_features() -> None:
    body = (
        '<Enumeration Name="Selector"><EnumEntry Name="Gain"><Value>1</Value></EnumEntry><pValue>Reg</pValue></Enumeration>'
        '<Float Name="Gain"><pValue>GainReg</pValue></Float>'
        '<FloatReg Name="GainReg"><pIndex>Selector</pIndex></FloatReg><IntReg Name="Reg"><Address>0</Address></IntReg>'
    )
    assert check_genicam(description(body)).longest_chain == 4


def test_limits_that_look_at_each_other_are_no_circle() -> None:
    body = (
        '<Integer Name="Width"><pValue>W</pValue><pMax>WidthMax</pMax></Integer><IntReg Name="W"/><IntReg Name="O"/>'
        '<Integer Name="OffsetX"><pValue>O</pValue><pMax>OffsetMax</pMax></Integer>'
        '<IntSwissKnife Name="WidthMax"><pVariable Name="X">OffsetX</pVariable><Formula>9-X</Formula></IntSwissKnife>'
        '<IntSwissKnife Name="OffsetMax"><pVariable Name="X">Width</pVariable><Formula>9-X</Formula></IntSwissKnife>'
    )
    assert check_genicam(description(body)).longest_chain == 3


@given(st.text(alphabet=" <>/=\"'&;!?[]-abpValueNm:\0\x1b", max_size=120))
@example("<a")
def test_any_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(CaptureError):
        assert check_genicam(description(text)).longest_chain <= LONGEST_CHAIN
