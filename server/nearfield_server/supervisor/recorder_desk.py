"""Starts and ends the recorder process on request."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import structlog

from nearfield_server.errors import ServiceError
from nearfield_server.recording.files.manifest import KINDS
from nearfield_server.recording.folder import check_target
from nearfield_server.supervisor.child import Child

FINISH_LIMIT_S: Final = 150.0
_ASK_PERIOD_S: Final = 0.5

_log = structlog.get_logger("nearfield.supervisor")


class RecorderDesk:
    """At most one recorder. All methods are called from the supervisor's main thread.

    Args:
        make_child: makes the process from its options.
        ask_to_finish: tells a running recorder to write what waits and end.
    """

    def __init__(
        self, make_child: Callable[[dict[str, Any]], Child], ask_to_finish: Callable[[], None]
    ) -> None:
        self.child: Child | None = None
        self.last: dict[str, Any] = {}
        """Last status of the recorder before, once it has ended."""
        self._make_child, self._ask_to_finish = make_child, ask_to_finish
        self._finish_by_s: float | None = None
        self._asked_s = 0.0

    def start(self, options: dict[str, Any], now_s: float, *, is_new: bool = True) -> Child:
        """Start recording.

        Args:
            options: `folder` (absolute), `kind`, and optionally `reserve_bytes` and `queue_bytes`.
            now_s: monotonic seconds.
            is_new: the folder must be new; else it may hold an earlier take of the same recording.

        Raises:
            ServiceError: a recording runs already, or the options are wrong.
        """
        if self.child is not None:
            raise ServiceError(
                "a recording is running already; end it with Ctrl-C where it was started, or `nearfield record --stop`"
            )
        folder, kind = options.get("folder"), options.get("kind")
        if not isinstance(folder, str) or not Path(folder).is_absolute() or kind not in KINDS:
            raise ServiceError(f"recording: expected an absolute folder and a kind among {KINDS}")
        if is_new:
            check_target(Path(folder))
        self.child = self._make_child(options)
        self.last, self._finish_by_s = {}, None
        self.child.start(now_s)
        return self.child

    def finish(self, now_s: float) -> None:
        """Let the recorder write what waits and end.

        Raises:
            ServiceError: there is no recording.
        """
        if self.child is None:
            raise ServiceError("there is no recording to end")
        if self._finish_by_s is None:
            self._finish_by_s = now_s + FINISH_LIMIT_S
            self._ask(now_s)

    def watch(self, now_s: float) -> None:
        """Look after the recorder: start it again when it was killed, and let go of it when it has ended as asked."""
        child = self.child
        if child is None:
            return
        if self._finish_by_s is None:
            child.watch(now_s)
            return
        if child.status.get("state") == "ended":
            child.terminate()
        if child.has_ended():
            self._let_go(child)
        elif now_s > self._finish_by_s:
            _log.warning("recorder did not end and is killed", pid=child.pid)
            child.finish(0.0)
            self._let_go(child)
        elif (
            child.status.get("state") not in ("finishing", "ended") and now_s - self._asked_s >= _ASK_PERIOD_S
        ):
            self._ask(now_s)  # it was not listening yet

    def report(self) -> dict[str, Any]:
        """What is known of the recording, for whoever asked for it."""
        child = self.child
        if child is None:
            return {"running": False, "recording": self.last}
        return {
            "running": True,
            "restarts": child.restarts,
            "last_fault": child.last_fault,
            "phase": child.status.get("phase", "starting"),
            "recording": _recording(child),
        }

    def _ask(self, now_s: float) -> None:
        self._asked_s = now_s
        self._ask_to_finish()

    def _let_go(self, child: Child) -> None:
        self.last = _recording(child)
        child.finish(0.0)
        self.child, self._finish_by_s = None, None


def _recording(child: Child) -> dict[str, Any]:
    """The newest numbers of a recorder, none before it has begun."""
    return child.status if "state" in child.status else {}
