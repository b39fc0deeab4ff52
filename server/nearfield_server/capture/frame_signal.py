"""Waking the one process that reads all frame rings."""

from __future__ import annotations

import contextlib
import os
import select


class FrameSignal:
    """The eventfd "frame ready" that all rings of a service share: writers ring it, the one consumer waits for it."""

    def __init__(self, fd: int) -> None:
        self.fd = fd

    @staticmethod
    def create() -> int:
        """Make the eventfd; its owner passes it on with `pass_fds`."""
        return os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)

    def notify(self) -> None:
        """Wake the consumer; never blocks (a full counter means that it is awake already)."""
        with contextlib.suppress(BlockingIOError):
            os.eventfd_write(self.fd, 1)

    def wait(self, timeout_s: float) -> bool:
        """Wait for a frame of any ring and take the signal back; false after `timeout_s` seconds without one."""
        poller = select.poll()
        poller.register(self.fd, select.POLLIN)
        if not poller.poll(max(0, round(timeout_s * 1000))):
            return False
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self.fd)
        return True
