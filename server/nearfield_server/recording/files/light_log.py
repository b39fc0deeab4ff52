"""`light.jsonl`: what every update of the light was made of, and the packet that came of it.

Three kinds of lines: `begin` (the pipeline has no past: everything afterwards follows from the lines of this run), `update`, `end`.
With it a replay can make the same updates of the same pictures and compare packets byte for byte.
"""

from __future__ import annotations

import base64
import binascii
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from nearfield_server.recording.files.json_lines import read_lines
from nearfield_server.records import ObjectPlacement

LIGHT_FILE: Final = "light.jsonl"


@dataclass(frozen=True, slots=True, kw_only=True)
class LightBegin:
    """The pipeline starts without a past.

    Attributes:
        run: from 1 in a take.
        first_sequence: number after which packets are counted.
        backend: what the stages ran on.
        room_revision: of the room model.
    """

    run: int
    first_sequence: int
    backend: str
    room_revision: int

    def to_fields(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "kind": "begin",
            "run": self.run,
            "first_sequence": self.first_sequence,
            "backend": self.backend,
            "room_revision": self.room_revision,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class LightStep:
    """One update.

    Attributes:
        run: that it belongs to.
        number: from 1 in the run, without gaps.
        frames: per camera the ring sequence of the picture, None = the one before stays in use.
        objects: all objects; None = as in the update before.
        packet: the light packet, None = the one before stays in force.
    """

    run: int
    number: int
    frames: tuple[int | None, ...]
    objects: tuple[ObjectPlacement, ...] | None
    packet: bytes | None

    def to_fields(self) -> dict[str, Any]:
        """As JSON has it; poses keep every bit."""
        fields: dict[str, Any] = {
            "kind": "update",
            "run": self.run,
            "number": self.number,
            "frames": list(self.frames),
        }
        if self.objects is not None:
            fields["objects"] = [
                [item.revision, [float(value) for value in item.world_from_object.ravel()]]
                for item in self.objects
            ]
        if self.packet is not None:
            fields["packet"] = base64.b64encode(self.packet).decode()
        return fields


@dataclass(frozen=True, slots=True, kw_only=True)
class LightRun:
    """A begin and the updates after it, whole up to `updates[-1]`."""

    take: int
    begin: LightBegin
    updates: tuple[LightStep, ...]


def line_of(take: int, fields: dict[str, Any]) -> str:
    """A line of the file."""
    return json.dumps({"take": take, **fields}, separators=(",", ":"), allow_nan=False)


def begin_from_fields(fields: dict[str, Any]) -> LightBegin:
    """Read a begin back.

    Raises:
        ValueError: a field is missing or impossible.
    """
    return LightBegin(
        run=_whole(fields, "run"),
        first_sequence=_whole(fields, "first_sequence"),
        backend=str(fields.get("backend", "")),
        room_revision=_whole(fields, "room_revision"),
    )


def step_from_fields(fields: dict[str, Any]) -> LightStep:
    """Read an update back.

    Raises:
        ValueError: a field is missing or impossible.
    """
    frames = fields.get("frames")
    if not isinstance(frames, list) or not all(
        entry is None or (type(entry) is int and 0 < entry < 1 << 63) for entry in frames
    ):
        raise ValueError(f"frames: expected numbers of frames or null, found {str(frames)[:60]!r}")
    packet = None
    if "packet" in fields:
        try:
            packet = base64.b64decode(fields["packet"], validate=True)
        except (TypeError, ValueError, binascii.Error) as error:
            raise ValueError(f"packet: expected base64 ({error})") from error
    return LightStep(
        run=_whole(fields, "run"),
        number=_whole(fields, "number"),
        frames=tuple(frames),
        objects=_objects(fields["objects"]) if "objects" in fields else None,
        packet=packet,
    )


def _objects(value: Any) -> tuple[ObjectPlacement, ...]:
    if not isinstance(value, list) or len(value) > 1024:
        raise ValueError("objects: expected a list")
    states = []
    for entry in value:
        if not isinstance(entry, list) or len(entry) != 2 or type(entry[0]) is not int:
            raise ValueError("objects: expected [revision, [16 numbers]]")
        try:
            pose = np.asarray(entry[1], np.float64)
        except (TypeError, ValueError, OverflowError):
            raise ValueError("objects: expected 16 numbers") from None
        if pose.shape != (16,) or not np.isfinite(pose).all():
            raise ValueError("objects: expected 16 finite numbers")
        states.append(ObjectPlacement(revision=entry[0], world_from_object=pose.reshape(4, 4)))
    return tuple(states)


def _whole(fields: dict[str, Any], name: str) -> int:
    value = fields.get(name)
    if type(value) is not int or not 0 <= value < 1 << 63:
        raise ValueError(f"{name}: expected a whole number, found {str(value)[:40]!r}")
    return value


def read_light_log(folder: Path, problems: list[str]) -> list[LightRun]:
    """All runs of a recording. What is damaged ends its run there, because nothing after it follows from what is known.

    Args:
        folder: of the recording.
        problems: what was passed over is told here, in words.
    """
    path = folder / LIGHT_FILE
    runs: list[LightRun] = []
    begin: LightBegin | None = None
    take, steps = 0, list[LightStep]()

    def finish() -> None:
        nonlocal begin
        if begin is not None:
            runs.append(LightRun(take=take, begin=begin, updates=tuple(steps)))
        begin = None

    for number, fields in read_lines(path, problems):
        try:
            if not isinstance(fields, dict):
                raise ValueError("expected an object")
            kind = fields.get("kind")
            if kind == "begin":
                finish()
                take, begin, steps = _whole(fields, "take"), begin_from_fields(fields), []
            elif kind == "update" and begin is not None:
                step = step_from_fields(fields)
                if (fields.get("take"), step.run) != (take, begin.run):
                    raise ValueError("update of another run")
                if step.number != len(steps) + 1:
                    raise ValueError(f"update {step.number} where {len(steps) + 1} is expected")
                if not steps and step.objects is None:
                    raise ValueError("the first update names no objects")
                steps.append(step)
            elif kind == "end":
                finish()
        except ValueError as error:
            problems.append(f"{path}:{number}: {error}; identity cannot be checked from here to the next run")
            finish()
    finish()
    return runs
