"""Is a replay of a recording the live run? Makes every update again and compares the packets byte for byte."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nearfield_protocol.codec import decode_light_packet
from nearfield_protocol.errors import ProtocolError
from nearfield_server.bus.messages import room_revision
from nearfield_server.errors import AssetError
from nearfield_server.illumination.object_bounds import ObjectBounds, load_bounds, object_poses
from nearfield_server.illumination.packet import PacketStream, PacketWriter
from nearfield_server.illumination.process import prepare_pipeline
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.recording.files.library import Recording, StoredFrame, open_recording
from nearfield_server.recording.files.light_log import LightRun, LightStep
from nearfield_server.recording.files.manifest import calibration_id
from nearfield_server.records import CameraFrame, ObjectPose, RoomMesh
from nearfield_server.scene.room_config import load_room


@dataclass(slots=True)
class CheckReport:
    """What the comparison found.

    Attributes:
        runs: begins of the light in the recording.
        updates: of the live run. updates_checked: made again.
        packets: of the live run among them. packets_equal: the same to the last byte.
        lost: per run that cannot be followed to its end: from which update on, and why.
        difference: the first packet that differs, in words.
        problems: lines and files that were passed over.
    """

    runs: int = 0
    updates: int = 0
    updates_checked: int = 0
    packets: int = 0
    packets_equal: int = 0
    lost: list[str] = field(default_factory=list)
    difference: str = ""
    problems: list[str] = field(default_factory=list)

    @property
    def is_identical(self) -> bool:
        """Every update was made again, and every packet is the same."""
        return (
            self.updates > 0
            and self.updates_checked == self.updates
            and self.packets_equal == self.packets
            and not self.difference
        )

    def lines(self) -> list[str]:
        """For people."""
        result = [
            *self.problems,
            f"{self.updates_checked} of {self.updates} updates made again; "
            f"{self.packets_equal} of {self.packets} packets are the same byte for byte",
            *self.lost,
        ]
        if self.difference:
            result.append(self.difference)
        if not self.updates:
            result.append("the recording holds no update of the light to compare with")
        result.append("identical" if self.is_identical else "NOT identical")
        return result


class _Frames:
    """Frames of a take by camera and ring sequence, read when they are needed."""

    def __init__(self, recording: Recording, take: int) -> None:
        self._tracks = recording.tracks
        self._stored: list[dict[int, StoredFrame]] = [
            {frame.info.sequence: frame for frame in track.frames if frame.info.take == take}
            for track in recording.tracks
        ]
        self._newest: list[CameraFrame | None] = [None] * len(recording.tracks)

    def get(self, camera: int, sequence: int) -> CameraFrame:
        """Read a frame; the one before is kept.

        Raises:
            AssetError: it was not recorded, or is damaged.
        """
        newest = self._newest[camera]
        if newest is not None and newest.sequence == sequence:
            return newest
        stored = self._stored[camera].get(sequence)
        track = self._tracks[camera]
        if stored is None:
            raise AssetError(f"frame {sequence} of camera {track.camera.camera_id} was not recorded")
        frame = CameraFrame(
            camera_index=camera,
            sequence=sequence,
            content_revision=sequence,
            timestamp_ns=stored.info.timestamp_ns,
            pixels=track.read(stored),
        )
        self._newest[camera] = frame
        return frame


def check_identity(
    folder: str | Path,
    *,
    backend: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> CheckReport:
    """Make every update of a recording again and compare.

    The result of an update depends on the pictures and poses of all updates since the begin of its run, and on nothing else: not on
    clocks, not on which tiles were known to be unchanged, not on the number of threads.

    Args:
        folder: of the recording.
        backend: of the light stages; None = that of the live run. Another one, or another kind of processor, may round differently.
        progress: called with updates done and in all.

    Raises:
        AssetError, ConfigError: the folder is no recording, or its room is damaged.
        GraphicsError: the backend cannot be had.
    """
    recording = open_recording(folder)
    report = CheckReport(problems=list(recording.problems))
    runs = recording.light_runs(report.problems)
    report.runs, report.updates = len(runs), sum(len(run.updates) for run in runs)
    room = load_room(folder)
    for camera, entry in zip(room.cameras, recording.manifest.cameras, strict=True):
        if calibration_id(camera) != entry.calibration_id:
            report.problems.append(
                f"camera {entry.camera_id}: lens or pose of the room file is not that of the recording"
            )
    bounds = load_bounds(room)
    prepared: dict[str, tuple[Callable[[], LightPipeline], RoomMesh]] = {}
    for run in runs:
        name = backend or run.begin.backend
        if name not in prepared:
            prepared[name] = prepare_pipeline(room, {"backend": name}, lambda *_: None)[:2]
        make, mesh = prepared[name]
        if room_revision(mesh.content_hash) != run.begin.room_revision:
            raise AssetError(f"{folder}: the room model is not the one that was recorded")
        _check_run(
            recording,
            run,
            make(),
            mesh,
            bounds,
            report,
            lambda: progress(report.updates_checked, report.updates),
        )
    return report


def _check_run(
    recording: Recording,
    run: LightRun,
    pipeline: LightPipeline,
    mesh: RoomMesh,
    bounds: list[ObjectBounds],
    report: CheckReport,
    progress: Callable[[], None],
) -> None:
    frames = _Frames(recording, run.take)
    stream = PacketStream(PacketWriter.for_room(mesh, run.begin.first_sequence))
    expected, poses = b"", list[ObjectPose]()
    for step in run.updates:
        try:
            pictures = [
                None if sequence is None else frames.get(camera, sequence)
                for camera, sequence in enumerate(step.frames)
            ]
        except (AssetError, IndexError) as error:
            report.lost.append(
                f"take {run.take}, run {run.begin.run}: identity is lost from update {step.number} of {len(run.updates)} on: {error}"
            )
            return
        poses = poses if step.objects is None else _poses(step, bounds)
        update = pipeline.update(pictures, poses)
        packet = stream.take(update, poses)
        report.updates_checked += 1
        if step.packet is not None:
            expected = step.packet
            report.packets += 1
            report.packets_equal += packet == expected
        if packet != expected and not report.difference:
            report.difference = (
                f"first difference in take {run.take}, run {run.begin.run}, update {step.number}: "
                + (describe_difference(expected, packet))
            )
        progress()


def _poses(step: LightStep, bounds: list[ObjectBounds]) -> list[ObjectPose]:
    """Poses as the pipeline takes them.

    Raises:
        AssetError: other objects than those of the room.
    """
    objects = step.objects or ()
    if len(objects) != len(bounds):
        raise AssetError(f"update {step.number}: {len(objects)} objects, the room has {len(bounds)}")
    return object_poses(objects, bounds)


def describe_difference(live: bytes, replayed: bytes) -> str:
    """In which fields two packets differ, and by how much."""
    try:
        left, right = decode_light_packet(live), decode_light_packet(replayed)
    except ProtocolError as error:
        return f"packets of {len(live)} and {len(replayed)} bytes ({error})"
    found = []
    for name in ("sequence", "timestamp_ns", "room_revision"):
        values = getattr(left, name), getattr(right, name)
        if values[0] != values[1]:
            found.append(f"{name} {values[0]} live, {values[1]} replayed")
    for name in ("object_sh", "object_revisions", "bounds_min", "bounds_size"):
        _compare(name, getattr(left, name), getattr(right, name), found)
    for name in left.vals.dtype.names or ():
        _compare(f"vals.{name}", left.vals[name], right.vals[name], found)
    return ", ".join(found) or "the same numbers in other bytes"


def _compare(name: str, left: np.ndarray, right: np.ndarray, found: list[str]) -> None:
    if left.shape != right.shape:
        found.append(f"{name} of shape {left.shape} live, {right.shape} replayed")
    elif not np.array_equal(left, right):
        distance = np.abs(left.astype(np.float64) - right.astype(np.float64)).max()
        found.append(f"{name} by at most {distance:.3g}")
