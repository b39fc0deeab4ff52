"""From a connected camera to the `source` table that opens it."""

from __future__ import annotations

import re
from collections.abc import Sequence

from nearfield_server.onboarding.connected import GIGE, USB3, Connected
from nearfield_server.onboarding.room_text import SourceValue
from nearfield_server.scene.device_schema import AravisSourceTable, DeviceSourceTable, V4l2SourceTable

_PHASES = ("RGGB", "GRBG", "GBRG", "BGGR")
# Usual names of V4L2, best first: raw codes of many bits, then what cameras for offices send.
_VIDEO_ORDER = (
    *(
        f"S{phase}{depth}"
        for depth in ("12P", "12", "14P", "14", "16", "10P", "10", "8")
        for phase in _PHASES
    ),
    *("YUYV", "UYVY", "RGB24", "BGR24", "MJPEG", "JPEG", "Y16", "Y14", "Y12", "Y12P", "Y10", "Y10P", "GREY"),
)


def choose_pixel_format(kind: str, offered: Sequence[str]) -> str | None:
    """The format that carries most light into the picture: colour first, then many bits, then few bytes.

    Args:
        kind: of the camera.
        offered: its formats.

    Returns:
        One of `offered`; None if none of them can be read.
    """
    if kind not in (GIGE, USB3):
        return next((name for name in _VIDEO_ORDER if name in offered), None)
    ranked = [(rank, name) for name in offered if (rank := _rank(name)) is not None]
    return max(ranked)[1] if ranked else None


def _rank(name: str) -> tuple[bool, int, int] | None:
    found = re.fullmatch(r"(Bayer(?:RG|GR|GB|BG)|Mono|RGB)(8|10|12|14|16)(p|Packed)?", name)
    if found is None or (found[1] == "RGB" and name != "RGB8"):
        return None
    bits = int(found[2])
    # A sensor rarely has more than twelve bits; sixteen of them are mostly empty and cost a third more.
    worth = {12: 5, 14: 4, 16: 3, 10: 2, 8: 1}[bits]
    packing = {"p": 2, "Packed": 1, None: 0}[found[3]]
    return found[1] != "Mono", worth, packing


def source_values(camera: Connected, pixel_format: str, exposure_s: float | None) -> dict[str, SourceValue]:
    """Keys of the `source` table, in the order in which they are written."""
    values: dict[str, SourceValue]
    if camera.kind == GIGE:
        values = {"kind": "aravis", "address": camera.place}
    elif camera.kind == USB3:
        values = {"kind": "aravis", "serial": camera.place}
    else:
        values = {"kind": "v4l2", "path": camera.place}
    values["pixel_format"] = pixel_format
    if exposure_s is not None:
        values["exposure_s"] = float(f"{exposure_s:.4g}")
    return values


def source_table(camera: Connected, pixel_format: str) -> DeviceSourceTable:
    """The same as a checked table."""
    model = V4l2SourceTable if camera.kind not in (GIGE, USB3) else AravisSourceTable
    return model.model_validate(source_values(camera, pixel_format, None))
