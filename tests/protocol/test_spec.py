"""The prose of SPEC.md states the numbers that the code uses."""

from __future__ import annotations

import math
from pathlib import Path

from nearfield_protocol import layout, light_records, quantise
from nearfield_protocol.layout import CloseCode
from nearfield_protocol.session import SessionLimits

TEXT = " ".join((Path(__file__).resolve().parents[2] / "protocol" / "SPEC.md").read_text().split())


def test_flow() -> None:
    limits = SessionLimits()
    assert f"{limits.control_queue} may wait, one more closes the connection (4008)" in TEXT
    assert f"stays unacknowledged for {limits.ack_timeout:g} s closes the connection (4009)" in TEXT
    assert (
        f"at most {limits.control_rate:g} messages per second on average (a burst of {limits.control_burst:g})"
        in TEXT
    )
    assert f"holds at most {limits.tiles_per_message} tiles" in TEXT


def test_sizes_and_ranges() -> None:
    plain = layout.VAL_PLAIN.itemsize, layout.OBJECT_SH_PLAIN.itemsize
    compact = layout.VAL_COMPACT.itemsize, layout.OBJECT_SH_COMPACT.itemsize
    assert (
        f"`{compact[0]} M + {compact[1]} n` bytes (compact) or `{plain[0]} M + {plain[1]} n` (plain" in TEXT
    )
    header = layout.MESSAGE_HEADER.itemsize + layout.LIGHT_PACKET.itemsize + 3 * layout.SECTION_ENTRY.itemsize
    assert f"{header} bytes of header and {layout.OBJECT_STATE.itemsize} bytes per object come on top" in TEXT
    assert f"areas in [0, {quantise.AREA_MAX:.0f}] m^2" in TEXT
    assert math.log2(quantise.MAX_RADIOMETRIC) == 126
    assert math.log2(light_records.MAX_COORDINATE) == 20
    assert quantise.MIN_SCALE_EXPONENT_RGB == quantise.MIN_SCALE_EXPONENT_HALF == -125
    assert TEXT.count("at least -125") == 2


def test_every_own_close_code_is_in_the_documented_range() -> None:
    for code in CloseCode:
        assert code in (1008, 1012) or 4000 <= code < 5000
        assert f"| {int(code)} | `{code.name}` |" in TEXT
