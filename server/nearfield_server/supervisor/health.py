"""Whether a process that exists also lives."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Health:
    """Judges one process by its status messages and its liveliness token. Pure: the caller brings the time.

    Attributes:
        silent_limit_s: without any status while it runs, the process is frozen.
        lost_limit_s: the same, once the liveliness token is gone too.
        beat_limit_s: oldest beat of a main loop that runs.
        start_limit_s: longest silence before the first status and while it prepares; imports and compilers are slow on a busy machine,
            and killing a process that only needs time would cost that time again.
        stopped_limit_s: longest that the system may hold the process still (SIGSTOP); such a process is frozen without doubt, however busy
            the machine is.
        preparing_limit_s: oldest beat while it prepares (a large room takes a while to load).
    """

    silent_limit_s: float = 5.0
    lost_limit_s: float = 3.0
    beat_limit_s: float = 8.0
    start_limit_s: float = 120.0
    stopped_limit_s: float = 1.5
    preparing_limit_s: float = 600.0
    _started_s: float = 0.0
    _last_status_s: float | None = None
    _beat_age_s: float = 0.0
    _phase: str = "starting"
    _token_lost: bool = False
    _stopped_since_s: float | None = None

    def started(self, now_s: float) -> None:
        """Begin with a new process."""
        self._started_s, self._last_status_s, self._token_lost = now_s, None, False
        self._beat_age_s, self._phase = 0.0, "starting"
        self._stopped_since_s = None

    def status(self, now_s: float, phase: str, beat_age_s: float) -> None:
        """Note a status message."""
        self._last_status_s, self._phase, self._beat_age_s = now_s, phase, beat_age_s

    def token(self, is_alive: bool) -> None:
        """Note a change of the liveliness token."""
        self._token_lost = not is_alive

    def held_still(self, now_s: float, is_stopped: bool) -> None:
        """Note whether the system holds the process still at the moment."""
        self._stopped_since_s = (self._stopped_since_s or now_s) if is_stopped else None

    def is_running(self, now_s: float) -> bool:
        """Whether the process is up and its main loop turns."""
        return self._phase == "running" and self.fault(now_s) is None

    def fault(self, now_s: float) -> str | None:
        """Return what is wrong, in words, or None."""
        if self._stopped_since_s is not None and now_s - self._stopped_since_s > self.stopped_limit_s:
            return f"stopped by a signal for {now_s - self._stopped_since_s:.1f} s"
        if self._last_status_s is None:
            if now_s - self._started_s > self.start_limit_s:
                return f"no status within {self.start_limit_s:.0f} s of its start"
            return None
        silent_s = now_s - self._last_status_s
        runs = self._phase == "running"
        if runs and self._token_lost and silent_s > self.lost_limit_s:
            return f"liveliness token lost and no status for {silent_s:.1f} s"
        if silent_s > (self.silent_limit_s if runs else self.start_limit_s):
            return f"no status for {silent_s:.1f} s"
        beat_age_s = self._beat_age_s + silent_s
        if beat_age_s > (self.beat_limit_s if runs else self.preparing_limit_s):
            return f"main loop stands still for {beat_age_s:.1f} s ({self._phase})"
        return None
