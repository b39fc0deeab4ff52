"""The memory of a frame ring: what lies where, and how it is made.

Layout (little endian): one page of `RING_HEADER`, then `slot_count` slots. A slot is one page of `SLOT_HEADER`, whole pages of tile
revisions and whole pages of pixels.
"""

from __future__ import annotations

import fcntl
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import FrameRingError
from nearfield_server.records import FRAME_TILE

MAGIC = b"NFRAMES\x00"
LAYOUT_VERSION = 4
PAGE = 4096
METADATA_BYTES = 2048
DEFAULT_SLOTS = 4
COUNTER_NAMES = ("nan", "infinite", "negative", "above_range", "lower_bound", "saturated")

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
        ("metadata_bytes", "<u8"),
        ("metadata", "u1", (METADATA_BYTES,)),
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
    def tile_grid(self) -> tuple[int, int]:
        """Rows and columns of tiles; those at the right and lower edge may be smaller."""
        return -(-self.height // FRAME_TILE), -(-self.width // FRAME_TILE)

    @property
    def pixel_offset(self) -> int:
        """Bytes from the begin of a slot to its pixels: a header page and whole pages of tile revisions."""
        rows, columns = self.tile_grid
        return PAGE + _whole_pages(rows * columns * 8)

    @property
    def slot_stride(self) -> int:
        """Bytes from one slot to the next."""
        return self.pixel_offset + _whole_pages(self.frame_bytes)

    @property
    def total_bytes(self) -> int:
        """Bytes of the whole ring."""
        return PAGE + self.slot_count * self.slot_stride


def _whole_pages(num_bytes: int) -> int:
    return -(-num_bytes // PAGE) * PAGE


def available_memory() -> int:
    """Bytes of memory that are free or can be freed.

    Raises:
        FrameRingError: the kernel does not say.
    """
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
    available = available_memory()
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


def read_shape(header: NDArray[Any], size: int, name: str, expected: RingShape | None) -> RingShape:
    """Return the shape of a ring from its header.

    Args:
        header: one `RING_HEADER`.
        size: bytes of the memory.
        name: for messages.
        expected: height and width that it must have, or None.

    Raises:
        FrameRingError: the memory is not the ring that `expected` describes.
    """
    if bytes(header["magic"]) != MAGIC.rstrip(b"\x00"):
        raise FrameRingError(
            f"frame ring '{name}': no frame ring (magic {bytes(header['magic'])!r}, expected {MAGIC!r})"
        )
    if header["layout_version"] != LAYOUT_VERSION:
        raise FrameRingError(
            f"frame ring '{name}': layout version {header['layout_version']}, expected {LAYOUT_VERSION}; "
            "writer and reader are of different releases"
        )
    if bytes(header["dtype"]) != b"<f2" or header["channels"] != 4:
        raise FrameRingError(
            f"frame ring '{name}': {header['channels']} channels of {bytes(header['dtype'])!r}, expected 4 of b'<f2'"
        )
    shape = RingShape(int(header["height"]), int(header["width"]), int(header["slot_count"]))
    if expected is not None and (shape.height, shape.width) != (expected.height, expected.width):
        raise FrameRingError(
            f"frame ring '{name}' holds {shape.width}x{shape.height} pixels, "
            f"expected {expected.width}x{expected.height}; the ring belongs to another camera"
        )
    if int(header["slot_stride"]) != shape.slot_stride or shape.slot_count < 2 or size != shape.total_bytes:
        raise FrameRingError(
            f"frame ring '{name}': {size} bytes with slots of {int(header['slot_stride'])}, "
            f"expected {shape.total_bytes} with slots of {shape.slot_stride} for {shape}"
        )
    return shape
