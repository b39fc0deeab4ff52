"""The last minutes of every camera and of the light, for the charts of the status page."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from nearfield_server.gateway.camera_summary import summarise_cameras

PERIOD_S: Final = 1.0
LENGTH: Final = 300
CAMERA_SERIES: Final = (
    "frame_rate",
    "frames_lost",
    "frames_broken",
    "saturated_share",
    "age_s",
    "temperature_c",
)
LIGHT_SERIES: Final = ("age_s", "updates", "clients")


@dataclass(slots=True)
class StatusHistory:
    """One sample a second, the newest `LENGTH` of them. One thread calls `sample`, any may call `as_json`.

    Counters ("frames_lost", "frames_broken", "updates") are kept as they are, so that nothing is lost between two samples; whoever draws
    them takes differences.
    """

    _samples: deque[tuple[float, dict[str, float | None], dict[str, dict[str, Any]]]] = field(
        default_factory=lambda: deque(maxlen=LENGTH)
    )
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def is_due(self, now_s: float) -> bool:
        """Whether a sample at a monotonic time would be taken."""
        with self._lock:
            return not self._samples or now_s - self._samples[-1][0] >= 0.9 * PERIOD_S

    def sample(self, now_s: float, statuses: Mapping[str, Mapping[str, Any]], num_clients: int) -> None:
        """Take a sample at a monotonic time; calls that come before a period is over are ignored."""
        if not self.is_due(now_s):
            return
        illumination = statuses.get("illumination", {})
        light = {
            "age_s": illumination.get("light_age_s"),
            "updates": illumination.get("updates"),
            "clients": num_clients,
        }
        cameras = {
            entry["id"]: {name: entry[name] for name in CAMERA_SERIES}
            for entry in summarise_cameras(statuses)
        }
        with self._lock:
            self._samples.append((now_s, light, cameras))

    def as_json(self, now_s: float) -> dict[str, Any]:
        """Columns, oldest first: `ago_s` (n,), `light` {series: (n,)}, `cameras` {id: {series: (n,)}}; null where nothing was known."""
        with self._lock:
            samples = list(self._samples)
        camera_ids = dict.fromkeys(camera_id for _, _, cameras in samples for camera_id in cameras)
        return {
            "period_s": PERIOD_S,
            "ago_s": [round(now_s - time_s, 2) for time_s, _, _ in samples],
            "light": {name: [light[name] for _, light, _ in samples] for name in LIGHT_SERIES},
            "cameras": {
                camera_id: {
                    name: [cameras.get(camera_id, {}).get(name) for _, _, cameras in samples]
                    for name in CAMERA_SERIES
                }
                for camera_id in camera_ids
            },
        }
