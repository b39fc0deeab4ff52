"""Whether a process that exists also lives."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Health:
    """Judges one process by its status messages and its liveliness token. Pure: the caller brings the time.

    Attributes:
        silent_limit_s: without any status after the first one, the process is frozen.
        start_limit_s: longest time to the first status.
        beat_limit_s: oldest beat of a main loop that runs.
        preparing_limit_s: oldest beat of a process that prepares (a large room takes a while to load).
        lost_limit_s: the same as `silent_limit_s`, once the liveliness token is gone too.
    """

    silent_limit_s: float = 5.0
    start_limit_s: float = 30.0
    beat_limit_s: float = 8.0
    preparing_limit_s: float = 600.0
    lost_limit_s: float = 3.0
    _started_s: float = 0.0
    _last_status_s: float | None = None
    _beat_age_s: float = 0.0
    _phase: str = "starting"
    _token_lost: bool = False

    def started(self, now_s: float) -> None:
        """Begin with a new process."""
        self._started_s, self._last_status_s, self._token_lost = now_s, None, False
        self._beat_age_s, self._phase = 0.0, "starting"

    def status(self, now_s: float, phase: str, beat_age_s: float) -> None:
        """Note a status message."""
        self._last_status_s, self._phase, self._beat_age_s = now_s, phase, beat_age_s

    def token(self, is_alive: bool) -> None:
        """Note a change of the liveliness token."""
        self._token_lost = not is_alive

    def is_running(self, now_s: float) -> bool:
        """Whether the process is up and its main loop turns."""
        return self._phase == "running" and self.fault(now_s) is None

    def fault(self, now_s: float) -> str | None:
        """Return what is wrong, in words, or None."""
        if self._last_status_s is None:
            if now_s - self._started_s > self.start_limit_s:
                return f"no status within {self.start_limit_s:.0f} s of its start"
            return None
        silent_s = now_s - self._last_status_s
        if self._token_lost and silent_s > self.lost_limit_s:
            return f"liveliness token lost and no status for {silent_s:.1f} s"
        if silent_s > self.silent_limit_s:
            return f"no status for {silent_s:.1f} s"
        beat_age_s = self._beat_age_s + silent_s
        limit_s = self.beat_limit_s if self._phase == "running" else self.preparing_limit_s
        if beat_age_s > limit_s:
            return f"main loop stands still for {beat_age_s:.1f} s ({self._phase})"
        return None
