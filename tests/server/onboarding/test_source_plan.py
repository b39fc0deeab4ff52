"""Which pixel format is proposed, and that what is written is what the schema reads."""

from __future__ import annotations

import pytest

from nearfield_server.onboarding.connected import Connected
from nearfield_server.onboarding.source_plan import choose_pixel_format, source_table, source_values
from nearfield_server.scene.device_schema import AravisSourceTable, V4l2SourceTable


@pytest.mark.parametrize(
    ("kind", "offered", "chosen"),
    [
        ("gige", ["Mono8", "BayerRG8", "BayerRG12", "BayerRG12p", "BayerRG16"], "BayerRG12p"),
        ("gige", ["Mono8", "BayerGB12Packed", "BayerGB12", "Mono12p"], "BayerGB12Packed"),
        ("usb3", ["Mono8", "Mono12", "Mono10p"], "Mono12"),
        ("usb3", ["Mono16", "RGB8"], "RGB8"),
        ("gige", ["Coord3D_ABC32f", "RGB10"], None),
        ("gige", [], None),
        ("v4l2", ["MJPEG", "YUYV"], "YUYV"),
        ("v4l2", ["YUYV", "SGRBG10", "SGRBG12"], "SGRBG12"),
        ("v4l2", ["NV12"], None),
    ],
)
def test_colour_first_then_bits_then_bytes(kind: str, offered: list[str], chosen: str | None) -> None:
    assert choose_pixel_format(kind, offered) == chosen


def test_tables_of_every_kind() -> None:
    gige = Connected(kind="gige", place="192.168.10.21", serial="4711")
    table = source_table(gige, "BayerRG12p")
    assert isinstance(table, AravisSourceTable)
    assert (str(table.address), table.serial) == ("192.168.10.21", None)
    usb = source_table(Connected(kind="usb3", place="23", serial="23"), "Mono8")
    assert isinstance(usb, AravisSourceTable)
    assert (usb.address, usb.serial) == (None, "23")
    video = Connected(kind="v4l2", place="/dev/video0")
    assert isinstance(source_table(video, "YUYV"), V4l2SourceTable)
    assert source_values(video, "YUYV", 0.0123456) == {
        "kind": "v4l2",
        "path": "/dev/video0",
        "pixel_format": "YUYV",
        "exposure_s": 0.01235,
    }
