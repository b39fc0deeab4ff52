"""Names on the bus; the table is in server/ARCHITECTURE.md."""

from __future__ import annotations

import re

LIGHT_PACKET = "light/packet"
LIGHT_ATLAS = "light/atlas"
CONTROL_REQUEST = "control/request"
CONTROL_STATE = "control/state"
STATUS = "status"
ALIVE = "alive"
PREVIEW = "preview"
LIGHT_LOG = "recording/light"
LIGHT_LOG_BEGIN = "recording/begin"
LIGHT_LOG_END = "recording/end"
RECORDING_FINISH = "recording/finish"

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]")


def room_prefix(room: str) -> str:
    """Return `nearfield/<room>`, with every character that has a meaning in key expressions replaced."""
    return f"nearfield/{_UNSAFE.sub('_', room) or 'room'}"


def status_key(process: str) -> str:
    """Return the key under which a process publishes its status."""
    return f"{STATUS}/{process}"


def alive_key(process: str) -> str:
    """Return the key of the liveliness token of a process."""
    return f"{ALIVE}/{process}"


def preview_key(process: str) -> str:
    """Return the key under which a capture process answers questions for a picture of its newest frame."""
    return f"{PREVIEW}/{process}"
