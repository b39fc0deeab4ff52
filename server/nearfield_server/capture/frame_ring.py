"""Frame ring: one writer process hands pictures to any number of reader processes through a memfd.

The supervisor makes the memory and owns it; the file descriptor is inherited by the writer and the readers. So a process that is
killed at any moment leaks nothing, and a restarted one finds its ring again. What lies where: `ring_memory`.

- The writer never waits: it overwrites the oldest slot (drop-oldest). A reader never waits: it takes the newest whole frame.
- `lock` of a slot is a sequence lock: odd while the slot is written. A writer killed in the middle leaves it odd, so that readers keep
  the frame before; the next writer takes the same slot again. `newest_sequence` moves only after a slot is whole.
- `generation` counts writers; it is the upper part of `content_revision`, so revisions of a restarted camera never repeat old ones.
- The revision of a tile is the content revision of the frame that changed it last. Being no flag, it tells readers that skip frames all
  that changed since the frame they took last, and a restarted writer goes on from the picture that it finds in the ring.
"""

from __future__ import annotations

import contextlib
import mmap
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.fence import full_fence
from nearfield_server.capture.ring_memory import (
    COUNTER_NAMES,
    METADATA_BYTES,
    PAGE,
    RING_HEADER,
    SLOT_HEADER,
    RingShape,
    read_shape,
)
from nearfield_server.errors import FrameRingError
from nearfield_server.records import CameraFrame

_GENERATION_SHIFT = 40  # 2^40 frames per writer are a thousand years at 30 Hz
_READ_ATTEMPTS = 8


class _Ring:
    """A mapped and verified ring; the common part of writer and reader."""

    def __init__(self, fd: int, name: str, expected: RingShape | None, access: int) -> None:
        self.name = name
        size = self._file_size(fd)
        if size < PAGE:
            raise FrameRingError(
                f"frame ring '{name}': {size} bytes, expected at least the header of {PAGE} bytes"
            )
        self._map = mmap.mmap(fd, size, access=access)
        header: NDArray[Any] = np.frombuffer(self._map, RING_HEADER, count=1)
        self._header = header
        try:
            self.shape = read_shape(header[0], size, name, expected)
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
            np.frombuffer(self._map, np.float16, count=count, offset=o + self.shape.pixel_offset).reshape(
                self.shape.height, self.shape.width, 4
            )
            for o in offsets
        ]
        rows, columns = self.shape.tile_grid
        self._tiles: list[NDArray[np.int64]] = [
            np.frombuffer(self._map, np.int64, count=rows * columns, offset=o + PAGE).reshape(rows, columns)
            for o in offsets
        ]

    def _file_size(self, fd: int) -> int:
        try:
            return os.fstat(fd).st_size
        except OSError as error:
            raise FrameRingError(
                f"frame ring '{self.name}': file descriptor {fd} is not open ({error.strerror}); it must be inherited from the supervisor"
            ) from error

    def close(self) -> None:
        """Unmap the memory. The file descriptor stays with its owner; views given out earlier keep the mapping alive."""
        self._slots, self._pixels, self._tiles = [], [], []
        self._header = np.zeros(1, RING_HEADER)
        self._close_map()

    def _close_map(self) -> None:
        with contextlib.suppress(BufferError):  # a view is still in use: the mapping goes with it
            self._map.close()


def _read_only(pixels: NDArray[np.float16]) -> NDArray[np.float16]:
    view = pixels.view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, slots=True)
class FrameDraft:
    """A frame that is being written.

    Attributes:
        pixels: (height, width, 4) float16; to be filled completely.
        counters: (6,) uint64 in the order of `COUNTER_NAMES`; to be filled completely.
        changed: (rows, columns) bool of the tiles, True at first; a tile may be cleared if its pixels are those of `previous`, bit for bit.
        previous: (height, width, 4) float16, pixels of the newest frame, read-only; None before the first frame.
    """

    pixels: NDArray[np.float16]
    counters: NDArray[np.uint64]
    changed: NDArray[np.bool_]
    previous: NDArray[np.float16] | None


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
    def write(self, content_revision: int, timestamp_ns: int, metadata: bytes = b"") -> Iterator[FrameDraft]:
        """Write one frame in place. A frame without any changed tile is not published: the newest one is confirmed instead.

        Args:
            content_revision: revision of the picture within this writer's life, below 2^40; must differ whenever the pixels do.
            timestamp_ns: capture time, CLOCK_MONOTONIC.
            metadata: what recordings keep of the frame, at most `METADATA_BYTES` (see `frame_metadata`).

        Yields:
            What must be filled. If the body raises, the slot stays marked as torn and the previous frame stays the newest.

        Raises:
            FrameRingError: too much metadata.
        """
        if len(metadata) > METADATA_BYTES:
            raise FrameRingError(
                f"frame ring '{self.name}': {len(metadata)} bytes of metadata, expected at most {METADATA_BYTES}"
            )
        newest = self.newest_sequence
        sequence = newest + 1
        index = sequence % self.shape.slot_count
        slot = self._slots[index]
        lock = int(slot["lock"][0])
        slot["lock"] = lock + (2 if lock % 2 else 1)
        full_fence()
        last = newest % self.shape.slot_count
        draft = FrameDraft(
            pixels=self._pixels[index],
            counters=slot["counters"][0],
            changed=np.ones(self.shape.tile_grid, np.bool_),
            previous=_read_only(self._pixels[last]) if newest else None,
        )
        yield draft
        if not draft.changed.any():
            # The slot stays marked as torn and is the next one to be written.
            self.confirm(timestamp_ns)
            return
        revision = (self.generation << _GENERATION_SHIFT) | content_revision
        slot["sequence"] = sequence
        slot["content_revision"] = revision
        slot["timestamp_ns"] = timestamp_ns
        slot["metadata_bytes"] = len(metadata)
        slot["metadata"][0, : len(metadata)] = np.frombuffer(metadata, np.uint8)
        self._tiles[index][...] = np.where(draft.changed, revision, self._tiles[last])
        full_fence()
        slot["lock"] += 1
        full_fence()
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
        metadata: what recordings keep of the frame besides, see `frame_metadata`.
        tile_revisions: (rows, columns) int64, a copy; see `CameraFrame`.
        pixels: (height, width, 4) float16, read-only.
    """

    sequence: int
    content_revision: int
    timestamp_ns: int
    confirmed_ns: int
    counters: dict[str, int]
    metadata: bytes
    tile_revisions: NDArray[np.int64]
    pixels: NDArray[np.float16]
    _ring: FrameRingReader
    _slot: int
    _lock: int

    def still_valid(self) -> bool:
        """Whether the writer left the slot alone since the view was made."""
        return self._ring.lock_is(self._slot, self._lock)

    def as_frame(self, camera_index: int) -> CameraFrame:
        """The frame as stages take it, its pixels still in shared memory."""
        return CameraFrame(
            camera_index=camera_index,
            sequence=self.sequence,
            content_revision=self.content_revision,
            timestamp_ns=self.timestamp_ns,
            pixels=self.pixels,
            tile_revisions=self.tile_revisions,
        )


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
    def newest_sequence(self) -> int:
        """Sequence of the newest whole frame, 0 before the first one."""
        return int(self._header["newest_sequence"][0])

    @property
    def confirmed_ns(self) -> int:
        """Last time the camera delivered a frame or said that the newest one still holds; 0 = never."""
        return int(self._header["confirmed_ns"][0])

    def lock_is(self, slot: int, lock: int) -> bool:
        """Whether the lock of a slot still has this value; everything read before the call is then whole."""
        full_fence()
        return int(self._slots[slot]["lock"][0]) == lock

    def newest(self) -> FrameView | None:
        """View the newest whole frame without copying it, or None if there is none (yet)."""
        for _ in range(_READ_ATTEMPTS):
            sequence = self.newest_sequence
            if sequence == 0:
                return None
            full_fence()
            view = self._view(sequence % self.shape.slot_count)
            if view is not None and view.still_valid():
                return view
        return None

    def at(self, sequence: int) -> FrameView | None:
        """View the frame of this number, or None if it is no longer (or not yet) there; the newest ones stay for a few periods."""
        view = self._view(sequence % self.shape.slot_count)
        is_it = view is not None and sequence > 0 and view.sequence == sequence and view.still_valid()
        return view if is_it else None

    def newest_copy(self, camera_index: int) -> CameraFrame | None:
        """Copy the newest whole frame, or None if there is none or the writer overtook every attempt."""
        for _ in range(_READ_ATTEMPTS):
            view = self.newest()
            if view is None:
                return None
            frame = replace(view.as_frame(camera_index), pixels=view.pixels.copy())
            if view.still_valid():
                return frame
        return None

    def _view(self, index: int) -> FrameView | None:
        slot = self._slots[index][0]
        lock = int(slot["lock"])
        if lock % 2:
            return None
        full_fence()
        counters = {name: int(value) for name, value in zip(COUNTER_NAMES, slot["counters"], strict=True)}
        return FrameView(
            sequence=int(slot["sequence"]),
            content_revision=int(slot["content_revision"]),
            timestamp_ns=int(slot["timestamp_ns"]),
            confirmed_ns=self.confirmed_ns,
            counters=counters,
            metadata=slot["metadata"][: min(int(slot["metadata_bytes"]), METADATA_BYTES)].tobytes(),
            tile_revisions=self._tiles[index].copy(),
            pixels=self._pixels[index],
            _ring=self,
            _slot=index,
            _lock=lock,
        )
