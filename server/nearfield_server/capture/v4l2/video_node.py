"""An opened video device node: the few system calls that everything else in this package is built on.

`VideoNode` is the seam for tests: a scripted node behaves as the V4L2 specification says, and all logic above runs unchanged.
"""

from __future__ import annotations

import ctypes
import fcntl
import mmap
import os
import select
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Readiness(Enum):
    """What a wait for a node ended with."""

    NOTHING = "nothing"
    FRAME = "frame"
    FAILED = "failed"  # the next request says why


class VideoNode(Protocol):
    """An opened node. Methods raise OSError with the kernel's error number."""

    def call(self, request: int, argument: ctypes.Structure | ctypes.c_int32) -> None:
        """Make one ioctl; the kernel reads and writes `argument` in place."""

    def map(self, length: int, offset: int) -> NDArray[np.uint8]:
        """Map a buffer of the driver; (length,) uint8. It stays mapped as long as the array or any view of it lives."""

    def wait(self, timeout_s: float) -> Readiness:
        """Wait until a frame can be taken, the node has failed, or the time is over."""

    def close(self) -> None:
        """Close the node; may be called twice."""


class KernelNode:
    """A node of the running kernel.

    Args:
        path: for example "/dev/video0"; symbolic links are followed anew each time.

    Raises:
        OSError: it cannot be opened.
    """

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)

    def call(self, request: int, argument: ctypes.Structure | ctypes.c_int32) -> None:
        """Make one ioctl, again where a signal broke in."""
        while True:
            try:
                fcntl.ioctl(self._fd, request, argument)
                return
            except InterruptedError:
                continue

    def map(self, length: int, offset: int) -> NDArray[np.uint8]:
        """Map a buffer of the driver."""
        memory = mmap.mmap(self._fd, length, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE, offset=offset)
        return np.frombuffer(memory, np.uint8)

    def wait(self, timeout_s: float) -> Readiness:
        """Poll the node."""
        events = self._poll.poll(max(0.0, timeout_s) * 1e3)
        if not events:
            return Readiness.NOTHING
        return Readiness.FRAME if events[0][1] & select.POLLIN else Readiness.FAILED

    def close(self) -> None:
        """Close the node."""
        if self._fd >= 0:
            self._poll.unregister(self._fd)
            os.close(self._fd)
            self._fd = -1
