"""Frames that wait for the disk: a bounded store between the rings, which do not wait, and writers, which may be slow."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nearfield_server.recording.files.frame_info import FrameInfo


@dataclass(slots=True)
class WaitingFrame:
    """A frame copied out of its ring.

    Attributes:
        camera: position in the room file.
        info: what is kept of it.
        pixels: (H, W, 4) float16, owned; give it back with `Backlog.done`.
        is_used: an update of the light was made of it.
    """

    camera: int
    info: FrameInfo
    pixels: NDArray[np.float16]
    is_used: bool = False


class Backlog:
    """First in, first out per camera, at most `max_bytes` in all. Any thread may call any method.

    When it is full, a frame that the light has passed over (a later one of its camera was used) makes room for the new one: it is the
    only kind that a replay can do without. Where there is none, the new frame is dropped.
    """

    def __init__(self, max_bytes: int, num_cameras: int) -> None:
        self.max_bytes = max_bytes
        self.dropped = [0] * num_cameras
        self.dropped_used = 0
        """Dropped frames that the light was made of: where a replay can no longer give the same packets."""
        self._waiting: list[deque[WaitingFrame]] = [deque() for _ in range(num_cameras)]
        self._bytes = 0
        self._newest_used = [0] * num_cameras
        self._lost: list[set[int]] = [set() for _ in range(num_cameras)]
        self._spare: dict[tuple[int, ...], list[NDArray[np.float16]]] = {}
        self._changed = threading.Condition()
        self._closed = False

    def buffer(self, shape: tuple[int, int, int]) -> NDArray[np.float16]:
        """Memory for a frame: used again, because fresh pages cost more than the copy."""
        with self._changed:
            spare = self._spare.get(shape)
            if spare:
                return spare.pop()
        return np.empty(shape, np.float16)

    def done(self, pixels: NDArray[np.float16]) -> None:
        """Take memory back; it is kept, so that a queue that has once been long need not be paid for again."""
        with self._changed:
            self._spare.setdefault(pixels.shape, []).append(pixels)

    def push(self, frame: WaitingFrame) -> bool:
        """Add a frame; false if it was dropped, and its memory is taken back then."""
        with self._changed:
            size = frame.pixels.nbytes
            while self._bytes + size > self.max_bytes and self._evict():
                pass
            # One frame always fits: a camera larger than the limit is still recorded, one frame at a time.
            if self._closed or (self._bytes and self._bytes + size > self.max_bytes):
                self._drop(frame)
                return False
            self._waiting[frame.camera].append(frame)
            self._bytes += size
            self._changed.notify_all()
            return True

    def take(self, cameras: Collection[int], timeout_s: float) -> WaitingFrame | None:
        """The oldest frame of these cameras, or None after `timeout_s` seconds without one, or when closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or any(self._waiting[c] for c in cameras), timeout_s)
            waiting = [self._waiting[camera] for camera in cameras if self._waiting[camera]]
            if not waiting:
                return None
            oldest = min(waiting, key=lambda frames: frames[0].info.timestamp_ns)
            frame = oldest.popleft()
            self._bytes -= frame.pixels.nbytes
            return frame

    def mark_used(self, camera: int, sequence: int) -> None:
        """The light was made of this frame."""
        with self._changed:
            if sequence in self._lost[camera]:
                self._lost[camera].discard(sequence)
                self.dropped_used += 1
            self._newest_used[camera] = max(self._newest_used[camera], sequence)
            for frame in self._waiting[camera]:
                if frame.info.sequence == sequence:
                    frame.is_used = True

    def lost(self, camera: int, sequence: int) -> None:
        """A frame never came this far: the ring had moved on."""
        with self._changed:
            self._remember_lost(camera, sequence)

    def clear(self) -> None:
        """Drop everything that waits: the disk takes no more."""
        with self._changed:
            for frames in self._waiting:
                while frames:
                    self._bytes -= frames[0].pixels.nbytes
                    self._drop(frames.popleft())

    def close(self) -> None:
        """Accept no more; what waits can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def is_closed(self) -> bool:
        """Whether nothing more comes."""
        with self._changed:
            return self._closed

    @property
    def num_frames(self) -> int:
        """Frames that wait."""
        with self._changed:
            return sum(len(frames) for frames in self._waiting)

    @property
    def num_bytes(self) -> int:
        """Bytes that wait."""
        with self._changed:
            return self._bytes

    def _evict(self) -> bool:
        """Drop the oldest frame that no update can be made of any more."""
        passed = [
            frame
            for frames, newest in zip(self._waiting, self._newest_used, strict=True)
            for frame in frames
            if not frame.is_used and frame.info.sequence < newest
        ]
        if not passed:
            return False
        frame = min(passed, key=lambda entry: entry.info.timestamp_ns)
        waiting = self._waiting[frame.camera]
        # By identity: comparing frames would compare pixels.
        self._waiting[frame.camera] = deque(entry for entry in waiting if entry is not frame)
        self._bytes -= frame.pixels.nbytes
        self._drop(frame)
        return True

    def _drop(self, frame: WaitingFrame) -> None:
        self.dropped[frame.camera] += 1
        if frame.is_used:
            self.dropped_used += 1
        else:
            self._remember_lost(frame.camera, frame.info.sequence)
        self._spare.setdefault(frame.pixels.shape, []).append(frame.pixels)

    def _remember_lost(self, camera: int, sequence: int) -> None:
        lost = self._lost[camera]
        lost.add(sequence)
        if len(lost) > 1024:  # the light has long gone past the oldest
            lost.discard(min(lost))
