"""Work that other threads hand to the main thread, and wait for."""

from __future__ import annotations

import queue
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

from nearfield_server.errors import ServiceError

T = TypeVar("T")


class Errands(Generic[T]):
    """Calls that only the main thread may make: processes must be started there, because their death signal watches it."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[tuple[Callable[[], T], Future[T]]] = queue.SimpleQueue()

    def request(self, action: Callable[[], T], timeout_s: float = 5.0) -> T:
        """From any thread: have `action()` called, and return or raise what it does.

        Raises:
            ServiceError: the main thread is busy or ending.
        """
        future: Future[T] = Future()
        self._waiting.put((action, future))
        try:
            return future.result(timeout_s)
        except TimeoutError:
            raise ServiceError("the service is busy or ending") from None

    def run(self) -> None:
        """From the main thread: do what waits."""
        while True:
            try:
                action, future = self._waiting.get_nowait()
            except queue.Empty:
                return
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(action())
            except Exception as error:
                future.set_exception(error)
