"""How long to wait before the next attempt."""

from __future__ import annotations

import random
from dataclasses import dataclass, field


@dataclass(slots=True)
class Backoff:
    """Delays that double from `initial_s` to `maximum_s`, each jittered by +-25 % so that processes do not retry in step."""

    initial_s: float = 0.5
    maximum_s: float = 10.0
    rng: random.Random = field(default_factory=random.Random)
    _attempts: int = 0

    def next_delay(self) -> float:
        """Return the delay before the next attempt, seconds."""
        delay = min(self.maximum_s, self.initial_s * 2.0 ** min(self._attempts, 30))
        self._attempts += 1
        return delay * self.rng.uniform(0.75, 1.25)

    def reset(self) -> None:
        """Start again from `initial_s`: the last attempt succeeded and held."""
        self._attempts = 0
