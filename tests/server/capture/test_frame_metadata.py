"""What recordings keep of a frame: through JSON and through the ring, never too long, never a reason to lose the frame."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.capture.frame_metadata import CUT, metadata_json, parse_metadata
from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.ring_memory import METADATA_BYTES, PAGE, SLOT_HEADER, RingShape, create_ring
from nearfield_server.errors import FrameRingError

_SCALARS = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
)
_OBJECTS = st.dictionaries(st.text(max_size=8), _SCALARS | st.lists(_SCALARS, max_size=4), max_size=6)


@given(_OBJECTS)
def test_metadata_comes_back_as_it_went_in_or_lacks_whole_entries(metadata: dict[str, Any]) -> None:
    text = metadata_json(metadata)
    assert len(text) <= METADATA_BYTES
    back = parse_metadata(text)
    if CUT not in back:
        assert back == metadata
    else:
        assert all(metadata[key] == value for key, value in back.items() if key != CUT)


def test_what_does_not_fit_or_is_no_json_is_left_out_and_said() -> None:
    back = parse_metadata(metadata_json({"gain": 2.0, "log": "x" * 3000, "bad": float("nan"), "id": "7"}))
    assert back == {CUT: True, "gain": 2.0, "id": "7"}
    assert parse_metadata(metadata_json({"array": np.zeros(2), "id": 1})) == {CUT: True, "id": 1}
    for text in (b"", b"{", b"[1]", b"\xff"):
        assert parse_metadata(text) == {}


def test_metadata_travels_with_its_frame_through_the_ring() -> None:
    fd = create_ring("test", RingShape(4, 4, 3))
    try:
        writer, reader = FrameRingWriter(fd, "w"), FrameRingReader(fd, "r")
        texts = [
            b"",
            b"{}",
            metadata_json({"exposures_s": [0.01, 0.1], "device_ns": "12345678901234567890"}),
            b"",
        ]
        for number, text in enumerate(texts, 1):
            with writer.write(number, number, text) as draft:
                draft.pixels[...] = number
                draft.counters[...] = 0
            view = reader.newest()
            assert view is not None
            assert view.metadata == text
        with pytest.raises(FrameRingError, match="2049 bytes"), writer.write(9, 9, b" " * 2049):
            pass
        assert reader.newest_sequence == len(texts)
    finally:
        os.close(fd)
    assert SLOT_HEADER.itemsize <= PAGE


def test_frames_are_found_by_their_number_as_long_as_they_last() -> None:
    fd = create_ring("test", RingShape(4, 4, 3))
    try:
        writer, reader = FrameRingWriter(fd, "w"), FrameRingReader(fd, "r")
        for number in range(1, 6):
            with writer.write(number, 10 * number) as draft:
                draft.pixels[...] = number
                draft.counters[...] = 0
        found = {number: reader.at(number) for number in range(8)}
        assert [number for number, view in found.items() if view is not None] == [3, 4, 5]
        assert all(view is None or (view.pixels == number).all() for number, view in found.items())
    finally:
        os.close(fd)
