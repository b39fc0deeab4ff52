"""`recording.json`: what a recording is of. Written whole under another name and renamed, so that it is never half there."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from nearfield_server.errors import AssetError
from nearfield_server.recording.files.frame_info import parse_json
from nearfield_server.records import CameraModel
from nearfield_server.whole_file import whole_file

MANIFEST_FILE: Final = "recording.json"
FORMAT: Final = 1
MAX_MANIFEST_BYTES: Final = 1 << 20
Kind = Literal["exr", "raw"]
KINDS: Final[tuple[Kind, ...]] = ("exr", "raw")


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraEntry:
    """A recorded camera.

    Attributes:
        camera_id: as in the room file.
        height: pixels. width: pixels.
        calibration_id: hash of lens and pose, see `calibration_id`.
    """

    camera_id: str
    height: int
    width: int
    calibration_id: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TakeEntry:
    """One life of a recorder.

    Attributes:
        number: from 1.
        started_ns: CLOCK_MONOTONIC. started_utc: ISO 8601.
        ended_ns: likewise, 0 where the recorder did not end by itself (killed, power cut) or has not yet.
        reason: why it ended, in words.
        frames_dropped: frames that the disk was too slow for, known at the end.
    """

    number: int
    started_ns: int
    started_utc: str
    ended_ns: int = 0
    reason: str = ""
    frames_dropped: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """The whole file.

    Attributes:
        kind: format of the frames.
        room_name: of the room.
        software: version of Nearfield that recorded.
        boot_id: of the machine's uptime whose CLOCK_MONOTONIC the times are of.
        frame_rate: frames per second asked of the cameras.
        cameras: in the order of the room file.
        takes: in order; at least one.
    """

    kind: Kind
    room_name: str
    software: str
    boot_id: str
    frame_rate: float
    cameras: tuple[CameraEntry, ...]
    takes: tuple[TakeEntry, ...]

    def with_take(self, take: TakeEntry) -> Manifest:
        """With a take added, or replaced if there is one of its number."""
        others = tuple(entry for entry in self.takes if entry.number != take.number)
        return replace(self, takes=(*others, take))


def calibration_id(camera: CameraModel) -> str:
    """Hash of a camera's lens and pose: 16 hexadecimal digits. Recordings of equal ids fit the same geometry."""
    lens = camera.intrinsics
    numbers = [lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, *lens.k, lens.theta_max]
    values = np.concatenate([np.asarray(numbers, "<f8"), np.asarray(camera.world_from_camera, "<f8").ravel()])
    return hashlib.sha256(values.tobytes()).hexdigest()[:16]


def boot_id() -> str:
    """Which uptime of this machine it is."""
    return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write `recording.json`, on disk when this returns.

    Raises:
        OSError: the disk refuses.
    """
    body = {
        "format": FORMAT,
        "kind": manifest.kind,
        "room_name": manifest.room_name,
        "software": manifest.software,
        "boot_id": manifest.boot_id,
        "frame_rate": manifest.frame_rate,
        "cameras": [
            {"id": c.camera_id, "height": c.height, "width": c.width, "calibration_id": c.calibration_id}
            for c in manifest.cameras
        ],
        "takes": [
            {
                "number": t.number,
                "started_ns": str(t.started_ns),
                "started_utc": t.started_utc,
                "ended_ns": str(t.ended_ns),
                "reason": t.reason,
                "frames_dropped": t.frames_dropped,
            }
            for t in manifest.takes
        ],
    }
    with whole_file(folder / MANIFEST_FILE, is_durable=True) as partial:
        partial.write_bytes(json.dumps(body, indent=1).encode())


def read_manifest(folder: Path) -> Manifest:
    """Read and check `recording.json`.

    Raises:
        AssetError: no recording, damaged, or of another release.
    """
    path = folder / MANIFEST_FILE
    if not path.is_file():
        raise AssetError(f"{folder}: no recording here, expected a file {MANIFEST_FILE}")
    if path.stat().st_size > MAX_MANIFEST_BYTES:
        raise AssetError(f"{path}: expected at most {MAX_MANIFEST_BYTES} bytes, found {path.stat().st_size}")
    try:
        body = parse_json(path.read_bytes())
        if not isinstance(body, dict):
            raise ValueError(f"expected an object, found {type(body).__name__}")
        if body.get("format") != FORMAT:
            raise ValueError(f"format: expected {FORMAT}, found {str(body.get('format'))[:20]!r}")
        if body["kind"] not in KINDS:
            raise ValueError(f"kind: expected one of {KINDS}, found {str(body['kind'])[:20]!r}")
        manifest = Manifest(
            kind=body["kind"],
            room_name=str(body["room_name"]),
            software=str(body["software"]),
            boot_id=str(body["boot_id"]),
            frame_rate=_rate(body["frame_rate"]),
            cameras=tuple(_camera(entry) for entry in body["cameras"]),
            takes=tuple(_take(entry) for entry in body["takes"]),
        )
    except KeyError as error:
        raise AssetError(f"{path}: expected a key {error}, found none") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise AssetError(f"{path}: {error}") from error
    if not manifest.cameras or not manifest.takes:
        raise AssetError(f"{path}: expected at least one camera and one take")
    return manifest


def _rate(value: Any) -> float:
    rate = float(value)
    if not 0.0 < rate <= 1000.0:
        raise ValueError(f"frame_rate: expected a rate above 0 and at most 1000, found {rate}")
    return rate


def _camera(entry: Any) -> CameraEntry:
    height, width = entry["height"], entry["width"]
    if not all(type(side) is int and 1 <= side <= 16384 for side in (height, width)):
        raise ValueError(f"cameras: expected sides of 1 to 16384 pixels, found {str((height, width))[:40]}")
    camera_id = str(entry["id"])
    if (
        not camera_id
        or len(camera_id) > 64
        or "/" in camera_id
        or camera_id.startswith(".")
        or "\0" in camera_id
    ):
        raise ValueError(f"cameras: {camera_id[:40]!r} is no name of a camera")
    return CameraEntry(
        camera_id=camera_id, height=height, width=width, calibration_id=str(entry["calibration_id"])
    )


def _take(entry: Any) -> TakeEntry:
    number = entry["number"]
    if type(number) is not int or not 1 <= number < 10_000:
        raise ValueError(f"takes: number {str(number)[:20]!r}, expected 1 to 9999")
    return TakeEntry(
        number=number,
        started_ns=int(entry["started_ns"]),
        started_utc=str(entry["started_utc"]),
        ended_ns=int(entry["ended_ns"]),
        reason=str(entry["reason"]),
        frames_dropped=int(entry["frames_dropped"]),
    )
