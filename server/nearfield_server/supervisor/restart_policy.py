"""When a dead process is started again."""

from __future__ import annotations

import random
from collections import deque
from dataclasses import dataclass, field

from nearfield_server.bus.backoff import Backoff


@dataclass(slots=True)
class RestartPolicy:
    """The first restart comes at once, the following ones with growing delays; five deaths within a minute mean half a minute of rest.

    Attributes:
        max_deaths: deaths within `window_s` that are one too many.
        window_s: seconds.
        rest_s: delay after that, seconds.
    """

    max_deaths: int = 5
    window_s: float = 60.0
    rest_s: float = 30.0
    rng: random.Random = field(default_factory=random.Random)
    _deaths: deque[float] = field(default_factory=deque)
    _backoff: Backoff | None = None

    def died(self, now_s: float) -> tuple[float, str]:
        """Note a death.

        Args:
            now_s: monotonic time.

        Returns:
            (seconds to wait before the restart, why in words).
        """
        while self._deaths and now_s - self._deaths[0] > self.window_s:
            self._deaths.popleft()
        if not self._deaths or self._backoff is None:
            self._backoff = Backoff(initial_s=0.25, maximum_s=4.0, rng=self.rng)
        self._deaths.append(now_s)
        count = len(self._deaths)
        if count >= self.max_deaths:
            return self.rest_s, (
                f"{count} deaths within {self.window_s:.0f} s: waiting {self.rest_s:.0f} s; "
                "its last log lines say what is wrong"
            )
        if count == 1:
            return 0.0, "restarting at once"
        delay_s = self._backoff.next_delay()
        return delay_s, f"death {count} within {self.window_s:.0f} s: restarting in {delay_s:.1f} s"
