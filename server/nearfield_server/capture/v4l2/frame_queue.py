"""Streaming: the driver's buffers, mapped once, and their way round between driver and reader. Nothing is copied."""

from __future__ import annotations

import ctypes
import errno
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.v4l2 import kernel_api as api
from nearfield_server.capture.v4l2.video_node import VideoNode
from nearfield_server.errors import CaptureError


@dataclass(frozen=True, slots=True)
class FilledBuffer:
    """A buffer that the driver has filled.

    Attributes:
        index: of the buffer; to be given back with `FrameQueue.put`.
        data: (bytes,) uint8, a view of the driver's memory.
        sequence: of the driver: counts exposed pictures, modulo 2^32.
        is_broken: the driver says that the picture is damaged.
        timestamp_ns: of the driver.
        is_monotonic: `timestamp_ns` is CLOCK_MONOTONIC.
        is_start: `timestamp_ns` is the start of the exposure; else the end of the transfer.
    """

    index: int
    data: NDArray[np.uint8]
    sequence: int
    is_broken: bool
    timestamp_ns: int
    is_monotonic: bool
    is_start: bool


class FrameQueue:
    """The buffers of one node; made after the format is set.

    Args:
        node: the opened node.
        buffer_type: its queue.
        count: buffers to ask for; drivers may give more or fewer.

    Raises:
        CaptureError: fewer than two buffers.
        OSError: in use by someone else (EBUSY), or gone.
    """

    def __init__(self, node: VideoNode, buffer_type: api.BufferType, count: int) -> None:
        self._node, self._type = node, buffer_type
        self.is_monotonic = False
        self._memory: list[NDArray[np.uint8]] = []
        answer = api.RequestBuffers(count=count, type=buffer_type, memory=api.MEMORY_MMAP)
        node.call(api.Request.REQBUFS, answer)
        if answer.count < 2:
            raise CaptureError(f"the driver gives {answer.count} buffers; expected two or more")
        try:
            self._map_all(answer.count)
        except BaseException:
            self.stop()
            raise

    def _map_all(self, count: int) -> None:
        for index in range(count):
            buffer, planes = self._blank(index)
            self._node.call(api.Request.QUERYBUF, buffer)
            length, offset = (
                (planes[0].length, planes[0].mem_offset)
                if self._is_planar
                else (buffer.length, buffer.offset)
            )
            self._memory.append(self._node.map(length, offset))
            self.is_monotonic = _is_monotonic(buffer.flags)

    def __len__(self) -> int:
        return len(self._memory)

    @property
    def _is_planar(self) -> bool:
        return self._type == api.BufferType.CAPTURE_MPLANE

    def _blank(self, index: int = 0) -> tuple[api.Buffer, ctypes.Array[api.Plane]]:
        """A request that concerns a buffer, and its planes (referred to by the request; unused where pictures have one piece)."""
        planes = (api.Plane * api.MAX_PLANES)()
        buffer = api.Buffer(index=index, type=self._type, memory=api.MEMORY_MMAP)
        if self._is_planar:
            buffer.planes = ctypes.cast(planes, ctypes.POINTER(api.Plane))
            buffer.length = api.MAX_PLANES
        return buffer, planes

    def start(self) -> None:
        """Queue every buffer and start the stream.

        Raises:
            OSError: no room on the bus (ENOSPC), in use, gone.
        """
        for index in range(len(self)):
            self.put(index)
        self._node.call(api.Request.STREAMON, ctypes.c_int32(self._type))

    def put(self, index: int) -> None:
        """Give a buffer to the driver."""
        self._node.call(api.Request.QBUF, self._blank(index)[0])

    def take(self) -> FilledBuffer | None:
        """Take the oldest filled buffer, None if there is none yet.

        Raises:
            OSError: the stream has failed (EIO), the device is gone (ENODEV).
        """
        buffer, planes = self._blank()
        try:
            self._node.call(api.Request.DQBUF, buffer)
        except BlockingIOError:
            return None
        except OSError as error:
            if error.errno == errno.EAGAIN:
                return None
            raise
        first, end = (
            (planes[0].data_offset, planes[0].bytesused) if self._is_planar else (0, buffer.bytesused)
        )
        source = buffer.flags & api.BufferFlag.TIMESTAMP_SOURCE_MASK
        return FilledBuffer(
            index=buffer.index,
            data=self._memory[buffer.index][first:end],
            sequence=buffer.sequence,
            is_broken=bool(buffer.flags & api.BufferFlag.ERROR),
            timestamp_ns=buffer.timestamp_s * 1_000_000_000 + buffer.timestamp_us * 1_000,
            is_monotonic=_is_monotonic(buffer.flags),
            is_start=source == api.BufferFlag.TIMESTAMP_START_OF_EXPOSURE,
        )

    def stop(self) -> None:
        """Stop the stream and free the driver's queue; a device that is gone has done both.

        Views of frames may outlive this: their memory is freed with the last of them. The queue is given up here all the same, because a
        mapping that is still referred to keeps the opened file, and with it the ownership of the queue, alive.
        """
        self._memory.clear()
        release = api.RequestBuffers(count=0, type=self._type, memory=api.MEMORY_MMAP)
        for request, argument in (
            (api.Request.STREAMOFF, ctypes.c_int32(self._type)),
            (api.Request.REQBUFS, release),
        ):
            try:
                self._node.call(request, argument)
            except OSError:
                continue  # gone, or a kernel before 5.0 that frees only what nobody has mapped


def _is_monotonic(flags: int) -> bool:
    return flags & api.BufferFlag.TIMESTAMP_MASK == api.BufferFlag.TIMESTAMP_MONOTONIC


class SequenceCounter:
    """Unwraps the driver's 32-bit sequence numbers and counts the gaps."""

    def __init__(self) -> None:
        self.lost = 0
        self._frame_id = -1
        self._last: int | None = None

    def restart(self) -> None:
        """The stream begins anew: the next number follows the last frame whatever it is."""
        self._last = None

    def unwrap(self, sequence: int) -> int:
        """Return the number of a frame: one more than the last one, plus the frames that are missing between them.

        Drivers that start again, or never count, lose nothing: a number that does not move forward by less than half its range counts as
        the next.
        """
        step = 1 if self._last is None else (sequence - self._last) % 2**32
        if not 0 < step < 2**31:
            step = 1
        self.lost += step - 1
        self._last = sequence
        self._frame_id += step
        return self._frame_id
