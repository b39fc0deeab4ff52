"""What a recording keeps of a frame besides its pixels, as it travels through the ring: a small JSON object."""

from __future__ import annotations

import json
from typing import Any

from nearfield_server.capture.ring_memory import METADATA_BYTES

CUT = "metadata_cut"
"""Set where entries had to be left out because they did not fit."""


def metadata_json(metadata: dict[str, Any]) -> bytes:
    """Write metadata as JSON of at most `METADATA_BYTES`; `parse_metadata` gives back an equal object.

    Entries that do not fit, or that JSON does not have (NaN, infinity), are left out and `metadata_cut` is set: a camera that says too
    much still delivers frames.
    """
    if not metadata:
        return b""
    text = _compact(metadata)
    if text is not None and len(text) <= METADATA_BYTES:
        return text
    kept: dict[str, Any] = {CUT: True}
    for key, value in metadata.items():
        longer = _compact({**kept, key: value})
        if longer is not None and len(longer) <= METADATA_BYTES:
            kept[key] = value
    return json.dumps(kept, separators=(",", ":")).encode()


def parse_metadata(text: bytes) -> dict[str, Any]:
    """Read metadata back; what is no JSON object gives none."""
    if not text:
        return {}
    try:
        value = json.loads(text)
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}


def _compact(metadata: dict[str, Any]) -> bytes | None:
    try:
        return json.dumps(metadata, separators=(",", ":"), allow_nan=False).encode()
    except (TypeError, ValueError):
        return None
