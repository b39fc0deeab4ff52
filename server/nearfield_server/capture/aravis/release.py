"""Giving objects back without waiting for a camera: each command to a dead one blocks for 2.5 s."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any

from nearfield_server.capture.aravis.library import Aravis


def release_later(
    aravis: Aravis,
    objects: Sequence[int | None],
    *,
    before: Callable[[], None] | None = None,
    keep: Sequence[Any] = (),
    wait_s: float = 0.0,
) -> bool:
    """Give references back in a thread of their own.

    Args:
        aravis: the library.
        objects: in the order in which they are given back; None is ignored.
        before: what is done first, in the same thread.
        keep: what must stay alive until all is given back: memory of buffers, handlers of signals.
        wait_s: how long to wait for it to be done.

    Returns:
        True if it is done.
    """

    def release() -> None:
        try:
            if before is not None:
                before()
        finally:
            for instance in objects:
                aravis.unref(instance)
            kept.clear()

    kept = list(keep)
    thread = threading.Thread(target=release, name="aravis-release", daemon=True)
    thread.start()
    thread.join(wait_s)
    return not thread.is_alive()
