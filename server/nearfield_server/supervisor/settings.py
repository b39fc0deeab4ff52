"""What `nearfield serve` asks of the service, handed from process to process as JSON."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from typing import Any

from nearfield_server.errors import ServiceError


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceSettings:
    """Settings of one service.

    Attributes:
        room_path: the room file or folder, absolute.
        host: address that the page is served on; 127.0.0.1 unless the user asks for the LAN.
        port: TCP port of the page, 0 = any free one.
        bus_port: port of the message bus on loopback.
        launcher_pid: the supervisor's parent.
        frame_rate: frames per second asked of the cameras, None = as the room file says.
        num_vals: None = as the room file says.
        split_ratio: share of direct light in (0, 1]; None = as the room file says.
        backend: of the light pipeline: auto, cpu, gl or reference.
        timeline: name of a lighting sequence of the bundle that simulated cameras play, or None.
        sensor: fields of `SensorModel` for simulated cameras, or None for exact pictures.
        record: `folder` and `kind` of a recording to begin with, or None.
        replay: how a recording is played: `speed`, `loop`, `lockstep`; None = as fast as it was recorded, over and over.
        gateway: further settings of the gateway.
    """

    room_path: str
    host: str = "127.0.0.1"
    port: int = 8080
    bus_port: int
    launcher_pid: int
    frame_rate: float | None = None
    num_vals: int | None = None
    split_ratio: float | None = None
    backend: str = "auto"
    timeline: str | None = None
    sensor: dict[str, float] | None = None
    record: dict[str, Any] | None = None
    replay: dict[str, Any] | None = None
    gateway: dict[str, Any] = dataclasses.field(default_factory=dict)

    def to_json(self) -> str:
        """Serialise to one line."""
        return json.dumps(dataclasses.asdict(self))

    @classmethod
    def from_json(cls, line: str) -> ServiceSettings:
        """Parse.

        Raises:
            ServiceError: not settings of this release.
        """
        try:
            return cls(**json.loads(line))
        except (ValueError, TypeError) as error:
            raise ServiceError(
                f"settings on standard input are malformed ({error}); start the service with `nearfield serve`"
            ) from error
