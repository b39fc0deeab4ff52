"""Lockstep replay: every recorded frame goes through the light pipeline, as fast as that goes, and on to the page.

`python -m nearfield_server.recording.player` stands in for the capture processes and the illumination process of a service.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from nearfield_server.bus.worker import Worker, run_worker
from nearfield_server.errors import AssetError, ServiceError
from nearfield_server.illumination.frames import FrameSource
from nearfield_server.illumination.pairing import PictureSet, choose_pictures
from nearfield_server.illumination.process import prepare_illumination
from nearfield_server.recording.files.library import Recording, open_recording
from nearfield_server.recording.files.timeline import group_frames, make_timeline
from nearfield_server.records import CameraFrame
from nearfield_server.scene.room_config import load_room

_IDLE_S = 0.1


class RecordedFrames(FrameSource):
    """The frames of a recording, update by update, in place of those of the rings."""

    torn = 0
    had_news = True
    always_copies = True
    pictures: PictureSet = choose_pictures((), (), 0)

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        timeline = make_timeline(recording.manifest, [track.infos for track in recording.tracks])
        self._updates = group_frames(timeline, round(1e9 / recording.manifest.frame_rate))
        self._frames: list[CameraFrame | None] = [None] * len(recording.tracks)
        self._index: list[int | None] = [None] * len(recording.tracks)
        self._count = 0
        self.position = 0
        self.unreadable = 0

    def __len__(self) -> int:
        return len(self._updates)

    def advance(self) -> bool:
        """Go to the next update; false at the end. A damaged frame is counted, and the one before stays in use."""
        if self.position >= len(self._updates):
            return False
        for camera, index in enumerate(self._updates[self.position]):
            if index is None or index == self._index[camera]:
                continue
            self._index[camera] = index
            track = self._recording.tracks[camera]
            stored = track.frames[index]
            self._count += 1
            try:
                self._frames[camera] = CameraFrame(
                    camera_index=camera,
                    sequence=stored.info.sequence,
                    content_revision=self._count,
                    timestamp_ns=stored.info.timestamp_ns,
                    pixels=track.read(stored),
                )
            except AssetError:
                self.unreadable += 1
        self.position += 1
        return True

    def rewind(self) -> None:
        """Begin again."""
        self.position, self._index = 0, [None] * len(self._index)

    def collect(self) -> list[CameraFrame | None]:
        """The frames of the present update."""
        return list(self._frames)

    def stayed_whole(self) -> bool:
        """Frames of a recording are never overwritten."""
        return True

    def recollect(self) -> list[CameraFrame | None]:
        """See `collect`."""
        return self.collect()

    def report(self, camera_ids: Sequence[str], now_ns: int, stale_after_s: float) -> list[dict[str, Any]]:
        """Recorded pictures do not grow old."""
        return [
            {
                "camera_id": name,
                "age_s": 0.0,
                "picture_age_s": 0.0,
                "paired": True,
                "stale": False,
                "generation": 1,
            }
            for name in camera_ids
        ]


def main(worker: Worker) -> None:
    """Prepare the room, then play until told to stop."""
    room = load_room(worker.spec.room_path)
    recording = open_recording(worker.spec.options["recording"])
    frames = RecordedFrames(recording)
    if not len(frames):
        raise ServiceError(f"{recording.folder}: the recording holds no frame")
    illumination = prepare_illumination(worker, room, frames)
    worker.wait_for_control(20.0)
    camera_ids = [camera.camera_id for camera in room.cameras]
    worker.describe(lambda: illumination.status(camera_ids, float("inf")))
    started_s, played = time.monotonic(), 0
    while not worker.stop.is_set():
        state = worker.control
        assert state is not None
        if frames.advance():
            played += 1
        elif worker.spec.options.get("loop", True):
            frames.rewind()
            continue
        else:
            worker.stop.wait(_IDLE_S)
        now_s = time.monotonic()
        illumination.step(state, now_s)
        worker.beat(
            preparing="",
            replay={
                "update": frames.position,
                "updates": len(frames),
                "played": played,
                "updates_per_s": round(played / max(now_s - started_s, 1e-9), 2),
                "unreadable_files": frames.unreadable,
            },
        )


if __name__ == "__main__":
    run_worker(main)
