"""What a person wants to know of each camera, put together from the statuses of the processes. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

LIVE, STALE, LOST, STARTING = "live", "stale", "lost", "starting"
"""Delivers; delivers nothing new for too long; not connected or its process is away; not there yet."""

_SILENT_AFTER_S = 3.0


def summarise_cameras(statuses: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return one entry per camera in the order of the room file.

    Args:
        statuses: newest status of every process by name, each with `status_age_s`, as in `GET /api/status`.

    Returns:
        Entries of JSON values: id, index, process, state ("live", "stale", "lost" or "starting"), fault (words, "" = none), warnings
        (words), kind, model, frame_rate (1/s), frames, frames_lost, frames_broken, frames_skipped, exposure_s (list, seconds),
        gain (linear), saturated_share (0 to 1), lower_bound_pixels, age_s, temperature_c, reconnects, restarts. What a camera
        does not tell is null.
    """
    ages = _by_camera_id(statuses.get("illumination", {}))
    children = _mapping(statuses.get("supervisor", {}).get("children"))
    entries = [
        _summary(name, status, ages, _mapping(children.get(name)))
        for name, status in statuses.items()
        if isinstance(status.get("camera_index"), int)
    ]
    return sorted(entries, key=lambda entry: int(entry["index"]))


def _by_camera_id(illumination: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    cameras = illumination.get("cameras")
    if not isinstance(cameras, list):
        return {}
    return {str(camera.get("camera_id")): camera for camera in cameras if isinstance(camera, dict)}


def _summary(
    name: str,
    status: Mapping[str, Any],
    ages: Mapping[str, Mapping[str, Any]],
    child: Mapping[str, Any],
) -> dict[str, Any]:
    source, counters = _mapping(status.get("source")), _mapping(status.get("counters"))
    camera_id = str(status.get("camera_id", name))
    age = ages.get(camera_id, {})
    fault = _fault(status, child)
    return {
        "id": camera_id,
        "index": status["camera_index"],
        "process": name,
        "state": _state(status, age, fault),
        "fault": fault,
        "warnings": [str(text) for text in source.get("warnings") or ()],
        "kind": _text(source.get("kind")),
        "model": _text(source.get("model")),
        "frame_rate": _number(status.get("frame_rate")),
        "frames": _number(status.get("frames")),
        "frames_lost": _number(source.get("frames_lost")),
        "frames_broken": _number(source.get("frames_broken")),
        "frames_skipped": _number(source.get("frames_skipped")),
        "exposure_s": _numbers(source.get("exposure_s")),
        "gain": _number(source.get("gain")),
        "saturated_share": _number(source.get("saturated_share")),
        "lower_bound_pixels": _number(counters.get("lower_bound")),
        "age_s": _number(age.get("age_s")),
        "temperature_c": _number(source.get("temperature_c")),
        "reconnects": _number(source.get("reconnects")),
        "restarts": _number(child.get("restarts")),
    }


def _fault(status: Mapping[str, Any], child: Mapping[str, Any]) -> str:
    silent_s = _number(status.get("status_age_s")) or 0.0
    if child and child.get("pid") is None:
        return f"its process {child.get('last_fault') or 'is away'}; it is started again"
    if silent_s > _SILENT_AFTER_S:
        return f"its process has said nothing for {silent_s:.0f} s"
    return str(status.get("fault") or "")


def _state(status: Mapping[str, Any], age: Mapping[str, Any], fault: str) -> str:
    if status.get("phase") == "starting" and not fault:
        return STARTING
    if fault or not status.get("connected"):
        return LOST
    return STALE if age.get("stale") else LIVE


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _text(value: Any) -> str | None:
    return str(value) if value not in (None, "") else None


def _number(value: Any) -> float | int | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return value


def _numbers(value: Any) -> list[float | int]:
    values = value if isinstance(value, list) else [value]
    return [number for number in map(_number, values) if number is not None]
