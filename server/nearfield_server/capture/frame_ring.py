"""Frame ring: one writer process hands pictures to any number of reader processes through a memfd.

The supervisor makes the memory and owns it; the file descriptor is inherited by the writer and the readers. So a process that is
killed at any moment leaks nothing, and a restarted one finds its ring again.

Layout (little endian): one page of `RING_HEADER`, then `slot_count` slots, each one page of `SLOT_HEADER` and the pixels, whole pages.

- The writer never waits: it overwrites the oldest slot (drop-oldest). A reader never waits: it takes the newest whole frame.
- `lock` of a slot is a sequence lock: odd while the slot is written. A writer killed in the middle leaves it odd, so that readers keep
  the frame before; the next writer takes the same slot again. `newest_sequence` moves only after a slot is whole.
- `generation` counts writers; it is the upper part of `content_revision`, so revisions of a restarted camera never repeat old ones.
"""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import FrameRingError
from nearfield_server.records import CameraFrame

MAGIC = b"NFRAMES\x00"
LAYOUT_VERSION = 1
PAGE = 4096
DEFAULT_SLOTS = 4
COUNTER_NAMES = ("nan", "infinite", "negative", "above_range", "saturated")
_GENERATION_SHIFT = 40  # 2^40 frames per writer are a thousand years at 30 Hz
_READ_ATTEMPTS = 8

RING_HEADER = np.dtype(
    [
        ("magic", "S8"),
        ("layout_version", "<u4"),
        ("slot_count", "<u4"),
        ("dtype", "S8"),
        ("height", "<u4"),
        ("width", "<u4"),
        ("channels", "<u4"),
        ("reserved", "<u4"),
        ("slot_stride", "<u8"),
        ("generation", "<u8"),
        ("newest_sequence", "<u8"),
        ("confirmed_ns", "<i8"),
    ]
)
SLOT_HEADER = np.dtype(
    [
        ("lock", "<u8"),
        ("sequence", "<u8"),
        ("content_revision", "<u8"),
        ("timestamp_ns", "<i8"),
        ("counters", "<u8", (len(COUNTER_NAMES),)),
    ]
)


@dataclass(frozen=True, slots=True)
class RingShape:
    """What a ring holds: pictures (height, width, 4) float16, `slot_count` of them."""

    height: int
    width: int
    slot_count: int = DEFAULT_SLOTS

    @property
    def frame_bytes(self) -> int:
        """Bytes of one picture."""
        return self.height * self.width * 4 * 2

    @property
    def slot_stride(self) -> int:
        """Bytes from one slot to the next: a header page and whole pages of pixels."""
        return PAGE + -(-self.frame_bytes // PAGE) * PAGE

    @property
    def total_bytes(self) -> int:
        """Bytes of the whole ring."""
        return PAGE + self.slot_count * self.slot_stride


def _available_memory() -> int:
    with open("/proc/meminfo", encoding="ascii") as file:
        for line in file:
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    raise FrameRingError(
        "/proc/meminfo has no line MemAvailable; cannot tell whether a frame ring fits into memory"
    )


def create_ring(name: str, shape: RingShape) -> int:
    """Make the memory of a ring, reserved in full and sealed against resizing.

    Args:
        name: shown in /proc/<pid>/fd for debugging.
        shape: size of the pictures and number of slots.

    Returns:
        The file descriptor (close-on-exec; pass it on with `subprocess` `pass_fds`). The memory lives as long as any process has it open.

    Raises:
        FrameRingError: the shape is impossible or there is not enough memory.
    """
    if (
        min(shape.height, shape.width) < 1
        or max(shape.height, shape.width) > 16384
        or not 2 <= shape.slot_count <= 64
    ):
        raise FrameRingError(
            f"frame ring '{name}': {shape.width}x{shape.height} with {shape.slot_count} slots is impossible; "
            "expected sides of 1 to 16384 pixels and 2 to 64 slots"
        )
    # memfd has no size limit of its own: asking for too much would wake the out-of-memory killer instead of failing.
    available = _available_memory()
    if shape.total_bytes > 0.8 * available:
        raise FrameRingError(
            f"frame ring '{name}' needs {shape.total_bytes / 1e6:.0f} MB, but only {available / 1e6:.0f} MB are free; "
            "use fewer or smaller cameras, or free memory"
        )
    fd = os.memfd_create(f"nearfield-{name}", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        # Reserved now, so that a full machine gives this error and not SIGBUS in the middle of a frame.
        os.posix_fallocate(fd, 0, shape.total_bytes)
        header = np.zeros(1, RING_HEADER)
        header["magic"] = MAGIC
        header["layout_version"] = LAYOUT_VERSION
        header["slot_count"] = shape.slot_count
        header["dtype"] = b"<f2"
        header["height"], header["width"], header["channels"] = shape.height, shape.width, 4
        header["slot_stride"] = shape.slot_stride
        os.pwrite(fd, header.tobytes(), 0)
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
    except OSError as error:
        os.close(fd)
        raise FrameRingError(
            f"frame ring '{name}': cannot reserve {shape.total_bytes / 1e6:.0f} MB of shared memory ({error.strerror}); "
            "use fewer or smaller cameras, or free memory"
        ) from error
    return fd


class _Ring:
    """A mapped and verified ring; the common part of writer and reader."""

    def __init__(self, fd: int, name: str, expected: RingShape | None, access: int) -> None:
        from nearfield_server.capture.fence import (
            full_fence,
        )  # numba: not needed by those who only make rings

        self.name = name
        self._fence = full_fence
        size = self._file_size(fd)
        if size < PAGE:
            raise FrameRingError(
                f"frame ring '{name}': {size} bytes, expected at least the header of {PAGE} bytes"
            )
        self._map = mmap.mmap(fd, size, access=access)
        header: NDArray[Any] = np.frombuffer(self._map, RING_HEADER, count=1)
        self._header = header
        try:
            self.shape = self._verified_shape(size, expected)
        except FrameRingError:
            self._close_map()
            raise
        full_fence()  # compiles now, not between two stores
        offsets = [PAGE + index * self.shape.slot_stride for index in range(self.shape.slot_count)]
        self._slots: list[NDArray[Any]] = [
            np.frombuffer(self._map, SLOT_HEADER, count=1, offset=o) for o in offsets
        ]
        count = self.shape.height * self.shape.width * 4
        self._pixels: list[NDArray[np.float16]] = [
            np.frombuffer(self._map, np.float16, count=count, offset=o + PAGE).reshape(
                self.shape.height, self.shape.width, 4
            )
            for o in offsets
        ]

    def _file_size(self, fd: int) -> int:
        try:
            return os.fstat(fd).st_size
        except OSError as error:
            raise FrameRingError(
                f"frame ring '{self.name}': file descriptor {fd} is not open ({error.strerror}); it must be inherited from the supervisor"
            ) from error

    def _verified_shape(self, size: int, expected: RingShape | None) -> RingShape:
        header = self._header[0]
        if bytes(header["magic"]) != MAGIC.rstrip(b"\x00"):
            raise FrameRingError(
                f"frame ring '{self.name}': no frame ring (magic {bytes(header['magic'])!r}, expected {MAGIC!r})"
            )
        if header["layout_version"] != LAYOUT_VERSION:
            raise FrameRingError(
                f"frame ring '{self.name}': layout version {header['layout_version']}, expected {LAYOUT_VERSION}; "
                "writer and reader are of different releases"
            )
        if bytes(header["dtype"]) != b"<f2" or header["channels"] != 4:
            raise FrameRingError(
                f"frame ring '{self.name}': {header['channels']} channels of {bytes(header['dtype'])!r}, expected 4 of b'<f2'"
            )
        shape = RingShape(int(header["height"]), int(header["width"]), int(header["slot_count"]))
        if expected is not None and (shape.height, shape.width) != (expected.height, expected.width):
            raise FrameRingError(
                f"frame ring '{self.name}' holds {shape.width}x{shape.height} pixels, "
                f"expected {expected.width}x{expected.height}; the ring belongs to another camera"
            )
        if (
            int(header["slot_stride"]) != shape.slot_stride
            or shape.slot_count < 2
            or size != shape.total_bytes
        ):
            raise FrameRingError(
                f"frame ring '{self.name}': {size} bytes with slots of {int(header['slot_stride'])}, "
                f"expected {shape.total_bytes} with slots of {shape.slot_stride} for {shape}"
            )
        return shape

    def close(self) -> None:
        """Unmap the memory. The file descriptor stays with its owner; views given out earlier keep the mapping alive."""
        self._slots, self._pixels = [], []
        self._header = np.zeros(1, RING_HEADER)
        self._close_map()

    def _close_map(self) -> None:
        with contextlib.suppress(BufferError):  # a view is still in use: the mapping goes with it
            self._map.close()


class FrameRingWriter(_Ring):
    """The only writer of a ring. Opening it starts a new generation.

    Raises:
        FrameRingError: the memory is not the ring that `expected` describes.
    """

    def __init__(self, fd: int, name: str, expected: RingShape | None = None) -> None:
        super().__init__(fd, name, expected, mmap.ACCESS_WRITE)
        self._header["generation"] += 1
        self.generation = int(self._header["generation"][0])

    @property
    def newest_sequence(self) -> int:
        """Sequence of the newest whole frame, 0 before the first one."""
        return int(self._header["newest_sequence"][0])

    @contextlib.contextmanager
    def write(
        self, content_revision: int, timestamp_ns: int
    ) -> Iterator[tuple[NDArray[np.float16], NDArray[np.uint64]]]:
        """Write one frame in place.

        Args:
            content_revision: revision of the picture within this writer's life, below 2^40; must differ whenever the pixels do.
            timestamp_ns: capture time, CLOCK_MONOTONIC.

        Yields:
            (pixels (height, width, 4) float16, counters (5,) uint64 in the order of `COUNTER_NAMES`): both must be filled completely.
            If the body raises, the slot stays marked as torn and the previous frame stays the newest.
        """
        sequence = self.newest_sequence + 1
        index = sequence % self.shape.slot_count
        slot = self._slots[index]
        lock = int(slot["lock"][0])
        slot["lock"] = lock + (2 if lock % 2 else 1)
        self._fence()
        slot["sequence"] = sequence
        slot["content_revision"] = (self.generation << _GENERATION_SHIFT) | content_revision
        slot["timestamp_ns"] = timestamp_ns
        yield self._pixels[index], slot["counters"][0]
        self._fence()
        slot["lock"] += 1
        self._fence()
        self._header["newest_sequence"] = sequence
        self._header["confirmed_ns"] = timestamp_ns

    def confirm(self, timestamp_ns: int) -> None:
        """Say that the newest frame is still what the camera sees at `timestamp_ns`: it stays young, and no pixels are copied."""
        self._header["confirmed_ns"] = timestamp_ns


@dataclass(frozen=True, slots=True)
class FrameView:
    """A frame in shared memory, not copied. Its content counts only if `still_valid()` is true after the last use.

    Attributes:
        sequence: counts up by one per frame.
        content_revision: equal revisions mean equal pixels.
        timestamp_ns: capture time, CLOCK_MONOTONIC.
        confirmed_ns: last time the camera said that the picture still holds; age is measured from here.
        counters: what ingest found in this frame, by `COUNTER_NAMES`.
        pixels: (height, width, 4) float16, read-only.
    """

    sequence: int
    content_revision: int
    timestamp_ns: int
    confirmed_ns: int
    counters: dict[str, int]
    pixels: NDArray[np.float16]
    _ring: FrameRingReader
    _slot: int
    _lock: int

    def still_valid(self) -> bool:
        """Whether the writer left the slot alone since the view was made."""
        return self._ring.lock_is(self._slot, self._lock)


class FrameRingReader(_Ring):
    """Reads the newest whole frame of a ring; maps the memory read-only.

    Raises:
        FrameRingError: the memory is not the ring that `expected` describes.
    """

    def __init__(self, fd: int, name: str, expected: RingShape | None = None) -> None:
        super().__init__(fd, name, expected, mmap.ACCESS_READ)

    @property
    def generation(self) -> int:
        """How many writers the ring has had."""
        return int(self._header["generation"][0])

    @property
    def confirmed_ns(self) -> int:
        """Last time the camera delivered a frame or said that the newest one still holds; 0 = never."""
        return int(self._header["confirmed_ns"][0])

    def lock_is(self, slot: int, lock: int) -> bool:
        """Whether the lock of a slot still has this value; everything read before the call is then whole."""
        self._fence()
        return int(self._slots[slot]["lock"][0]) == lock

    def newest(self) -> FrameView | None:
        """View the newest whole frame without copying it, or None if there is none (yet)."""
        for _ in range(_READ_ATTEMPTS):
            sequence = int(self._header["newest_sequence"][0])
            if sequence == 0:
                return None
            self._fence()
            view = self._view(sequence % self.shape.slot_count)
            if view is not None and view.still_valid():
                return view
        return None

    def newest_copy(self, camera_index: int) -> CameraFrame | None:
        """Copy the newest whole frame, or None if there is none or the writer overtook every attempt."""
        for _ in range(_READ_ATTEMPTS):
            view = self.newest()
            if view is None:
                return None
            pixels = view.pixels.copy()
            if view.still_valid():
                return CameraFrame(
                    camera_index=camera_index,
                    sequence=view.sequence,
                    content_revision=view.content_revision,
                    timestamp_ns=view.timestamp_ns,
                    pixels=pixels,
                )
        return None

    def _view(self, index: int) -> FrameView | None:
        slot = self._slots[index][0]
        lock = int(slot["lock"])
        if lock % 2:
            return None
        self._fence()
        counters = {name: int(value) for name, value in zip(COUNTER_NAMES, slot["counters"], strict=True)}
        return FrameView(
            sequence=int(slot["sequence"]),
            content_revision=int(slot["content_revision"]),
            timestamp_ns=int(slot["timestamp_ns"]),
            confirmed_ns=self.confirmed_ns,
            counters=counters,
            pixels=self._pixels[index],
            _ring=self,
            _slot=index,
            _lock=lock,
        )
