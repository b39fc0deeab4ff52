"""The one time axis of all cameras of a recording, and which frames belong to one update. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nearfield_server.recording.files.frame_info import FrameInfo
from nearfield_server.recording.files.manifest import Manifest


@dataclass(frozen=True, slots=True)
class Timeline:
    """When frames are due, nanoseconds from the begin.

    Attributes:
        due_ns: per camera, per frame, not descending.
        duration_ns: when the recording begins again, > 0.
    """

    due_ns: tuple[tuple[int, ...], ...]
    duration_ns: int


def make_timeline(manifest: Manifest, tracks: Sequence[Sequence[FrameInfo]]) -> Timeline:
    """Lay the frames of all cameras on one axis.

    The picture that a camera showed when the recorder started is due at once, however old it was. Between two takes, where nothing was
    recorded, one period passes.

    Args:
        manifest: of the recording.
        tracks: per camera, the frames in the order of recording.
    """
    period_ns = max(1, round(1e9 / manifest.frame_rate))
    started = {take.number: take.started_ns for take in manifest.takes}
    ended = {take.number: take.ended_ns for take in manifest.takes}
    shift_ns = dict[int, int]()
    position_ns = 0
    for number in sorted({info.take for infos in tracks for info in infos}):
        # A damaged manifest may lack the take: it then begins with its first frame.
        times = [info.timestamp_ns for infos in tracks for info in infos if info.take == number]
        first_ns = min(max(time_ns, started.get(number, 0)) for time_ns in times)
        last_ns = max(max(times), first_ns)
        shift_ns[number] = position_ns - first_ns
        # A picture that held to the end is shown to the end.
        position_ns += max(last_ns + period_ns, min(ended.get(number, 0), last_ns + 3600 * 10**9)) - first_ns
    due = []
    for infos in tracks:
        latest, row = 0, []
        for info in infos:
            latest = max(latest, max(info.timestamp_ns, started.get(info.take, 0)) + shift_ns[info.take])
            row.append(latest)
        due.append(tuple(row))
    return Timeline(tuple(due), max(position_ns, period_ns))


def group_frames(timeline: Timeline, period_ns: int) -> list[tuple[int | None, ...]]:
    """Group frames into updates: those of several cameras that are less than half a period apart belong together.

    Every frame is in one update.

    Args:
        timeline: of the recording.
        period_ns: between two frames of a camera.

    Returns:
        Per update, per camera the index of its newest frame, None before its first one.
    """
    events = sorted(
        (due, camera, index) for camera, row in enumerate(timeline.due_ns) for index, due in enumerate(row)
    )
    updates: list[tuple[int | None, ...]] = []
    newest: list[int | None] = [None] * len(timeline.due_ns)
    fresh: set[int] = set()
    since_ns = 0
    for due, camera, index in events:
        if fresh and (camera in fresh or 2 * (due - since_ns) > period_ns):
            updates.append(tuple(newest))
            fresh = set()
        if not fresh:
            since_ns = due
        newest[camera] = index
        fresh.add(camera)
    if fresh:
        updates.append(tuple(newest))
    return updates
