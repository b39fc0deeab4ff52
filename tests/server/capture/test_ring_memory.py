"""The memory of a ring: reserved in full, sealed, and refused when it is not what was expected."""

from __future__ import annotations

import os
import resource
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.ring_memory import PAGE, RingShape, create_ring
from nearfield_server.errors import FrameRingError

SHAPE = RingShape(6, 5, 3)


@pytest.fixture
def make_ring() -> Iterator[Callable[[RingShape], int]]:
    fds: list[int] = []

    def make(shape: RingShape = SHAPE) -> int:
        fds.append(create_ring("test", shape))
        return fds[-1]

    yield make
    for fd in fds:
        os.close(fd)


@given(st.integers(1, 16384), st.integers(1, 16384), st.integers(2, 64))
def test_header_tiles_and_pixels_lie_apart_on_whole_pages(height: int, width: int, slots: int) -> None:
    shape = RingShape(height, width, slots)
    rows, columns = shape.tile_grid
    assert (rows - 1) * 32 < height <= rows * 32
    assert (columns - 1) * 32 < width <= columns * 32
    assert shape.pixel_offset >= PAGE + rows * columns * 8
    assert shape.slot_stride >= shape.pixel_offset + height * width * 8
    assert shape.pixel_offset % PAGE == shape.slot_stride % PAGE == 0


def test_the_memory_cannot_be_resized(make_ring: Callable[..., int]) -> None:
    fd = make_ring()
    for size in (0, SHAPE.total_bytes + PAGE):
        with pytest.raises(PermissionError):
            os.ftruncate(fd, size)


@pytest.mark.parametrize(
    ("offset", "damage", "words"),
    [
        (0, b"XXXX", "magic"),
        (8, b"\x63\0\0\0", "layout version 99"),
        (12, b"\x20\0\0\0", "expected"),
        (16, b"<f4\0", "channels"),
        (24, b"\x07\0\0\0", "another camera"),
        (40, b"\x01", "slots of"),
    ],
)
def test_a_damaged_header_is_refused_in_words(
    make_ring: Callable[..., int], offset: int, damage: bytes, words: str
) -> None:
    fd = make_ring()
    os.pwrite(fd, damage, offset)
    for kind in (FrameRingReader, FrameRingWriter):
        with pytest.raises(FrameRingError, match=words):
            kind(fd, "test", SHAPE)


def test_foreign_memory_is_refused(make_ring: Callable[..., int]) -> None:
    fd = make_ring()
    with pytest.raises(FrameRingError, match="another camera"):
        FrameRingReader(fd, "test", RingShape(8, 5, 3))
    empty = os.memfd_create("empty")
    try:
        with pytest.raises(FrameRingError, match="at least the header"):
            FrameRingReader(empty, "test")
    finally:
        os.close(empty)
    with pytest.raises(FrameRingError, match="not open"):
        FrameRingReader(empty, "test")


def test_impossible_and_too_large_rings_are_refused_before_memory_is_touched() -> None:
    for shape in (RingShape(0, 4), RingShape(4, 20_000), RingShape(4, 4, 1)):
        with pytest.raises(FrameRingError, match="impossible"):
            create_ring("test", shape)
    with pytest.raises(FrameRingError, match="are free"):
        create_ring("test", RingShape(16384, 16384, 64))


def test_running_out_of_memory_while_reserving_is_an_error_in_words_and_leaks_nothing() -> None:
    before = set(os.listdir("/proc/self/fd"))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (PAGE, limits[1]))
    try:
        with pytest.raises(FrameRingError, match="cannot reserve"):
            create_ring("test", SHAPE)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert set(os.listdir("/proc/self/fd")) == before
