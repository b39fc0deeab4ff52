"""Recorded frames in MCAP containers: cheap enough for full rate on a small machine.

Each frame is two messages of one time and sequence: `<camera>/info` (JSON, as in the other format) and `<camera>/pixels` (see
`packed_picture`). Messages are not chunked: what was handed to the kernel is there, whatever happens to the recorder. A segment ends
after a minute or a gigabyte. A cut segment is read up to the cut.
"""

from __future__ import annotations

import contextlib
import os
import struct
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer
from numpy.typing import NDArray

from nearfield_server.errors import AssetError
from nearfield_server.recording.files.frame_info import MAX_INFO_BYTES, FrameInfo, info_from_json
from nearfield_server.recording.files.manifest import CameraEntry
from nearfield_server.recording.files.packed_picture import (
    PIXEL_ENCODING,
    PIXEL_SCHEMA,
    pack_picture,
    unpack_picture,
)

SEGMENTS_FOLDER: Final = "segments"
SEGMENT_BYTES: Final = 1_000_000_000
SEGMENT_SECONDS: Final = 60.0
_MAGIC: Final = b"\x89MCAP0\r\n"
_RECORD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")
_MAX_RECORD: Final = 4 << 30
_MAX_CHANNELS: Final = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class RawFrame:
    """Where a frame is: `length` bytes of packed pixels at `offset` of a segment."""

    info: FrameInfo
    path: Path
    offset: int
    length: int


class _Segment:
    """One file that is being written."""

    def __init__(self, path: Path, cameras: tuple[CameraEntry, ...], now_s: float) -> None:
        self.started_s = now_s
        self._file = path.open("xb", buffering=0)
        self._output = _AllOrNothing(self._file)
        self._writer = Writer(
            self._output,  # type: ignore[arg-type]
            compression=CompressionType.NONE,
            index_types=IndexType.NONE,
            use_chunking=False,
            use_statistics=False,
        )
        self._writer.start(profile="", library="nearfield")
        info_schema = self._writer.register_schema("nearfield.FrameInfo", "jsonschema", b'{"type":"object"}')
        pixel_schema = self._writer.register_schema("nearfield.Pixels", "text", PIXEL_SCHEMA.encode())
        self._channels = []
        for camera in cameras:
            facts = {
                "height": str(camera.height),
                "width": str(camera.width),
                "calibration": camera.calibration_id,
            }
            self._channels.append(
                (
                    self._writer.register_channel(f"{camera.camera_id}/info", "json", info_schema, facts),
                    self._writer.register_channel(
                        f"{camera.camera_id}/pixels", PIXEL_ENCODING, pixel_schema, facts
                    ),
                )
            )
        # It also hands the lines above to the kernel: messages go there past the library.
        self._writer.add_metadata("nearfield", {"cameras": str(len(cameras))})

    @property
    def size(self) -> int:
        return self._file.tell()

    def add(self, camera: int, info: FrameInfo, packed: tuple[bytes, bytes]) -> int:
        checksum, body = packed
        text = info.to_json().encode()
        times = (info.sequence & 0xFFFFFFFF, info.timestamp_ns, info.timestamp_ns)
        info_channel, pixel_channel = self._channels[camera]
        start = self.size
        try:
            # Past the library, which would copy each picture three times, and keep every other thread waiting meanwhile.
            self._output.write(
                _message_head(info_channel, times, len(text))
                + text
                + _message_head(pixel_channel, times, len(checksum) + len(body))
                + checksum
            )
            self._output.write(body)
        except OSError:
            # Nothing may stand behind half a record: it would be taken for its end.
            self._file.truncate(start)
            self._file.seek(start)
            raise
        return self.size - start

    def finish(self) -> None:
        """Write the last lines."""
        with contextlib.suppress(OSError):  # a segment without them is as good
            self._writer.finish()  # type: ignore[no-untyped-call]

    def sync(self) -> None:
        """Wait for the disk; others may `add` meanwhile."""
        os.fdatasync(self._file.fileno())
        # Nobody reads this soon: the memory serves what comes next, instead of all other files that the machine holds ready.
        os.posix_fadvise(self._file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)

    def close(self) -> None:
        self._file.close()


def _message_head(channel: int, times: tuple[int, int, int], size: int) -> bytes:
    """What stands before the `size` bytes of a message; `times`: its sequence, and when it was logged and published in nanoseconds."""
    return _RECORD.pack(Opcode.MESSAGE, _MESSAGE.size + size) + _MESSAGE.pack(channel, *times)


class _AllOrNothing:
    """A file whose `write` writes everything or raises."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            view = view[self._file.write(view) :]
        return len(data)

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        """Nothing waits here."""


class RawWriter:
    """Writes frames of all cameras into segments of one take. Threads compress side by side; the file is written by one at a time.

    Raises:
        OSError: from every method, when the disk refuses; the frame in hand is then not there.
    """

    def __init__(
        self,
        folder: Path,
        cameras: tuple[CameraEntry, ...],
        take: int,
        *,
        segment_bytes: int = SEGMENT_BYTES,
        segment_s: float = SEGMENT_SECONDS,
    ) -> None:
        self._folder, self._cameras, self._take = folder / SEGMENTS_FOLDER, cameras, take
        self._segment_bytes, self._segment_s = segment_bytes, segment_s
        self._folder.mkdir(parents=True, exist_ok=True)
        self._lock = threading.Lock()
        self._sync_lock = threading.Lock()
        self._number = 0
        self._segment: _Segment | None = None
        self._ended: list[_Segment] = []

    def write(self, camera: int, info: FrameInfo, pixels: NDArray[np.float16]) -> int:
        """Write a frame (H, W, 4) and return its bytes on disk."""
        packed = pack_picture(pixels)
        now_s = info.timestamp_ns * 1e-9
        with self._lock:
            segment = self._segment
            if segment is not None and (
                segment.size >= self._segment_bytes or now_s - segment.started_s >= self._segment_s
            ):
                self._end_segment()
                segment = None
            if segment is None:
                self._number += 1
                path = self._folder / f"{self._take:04d}_{self._number:05d}.mcap"
                segment = self._segment = _Segment(path, self._cameras, now_s)
            return segment.add(camera, info, packed)

    def sync(self) -> None:
        """Wait until the disk has everything written so far; others may write meanwhile."""
        with self._sync_lock:
            with self._lock:
                ended, self._ended = self._ended, []
                segment = self._segment
            try:
                while ended:
                    ended[0].sync()
                    ended.pop(0).close()
            finally:
                with self._lock:
                    self._ended = ended + self._ended
            # Only `sync` closes segments, so this one is open even if it has ended by now.
            if segment is not None:
                segment.sync()

    def close(self) -> None:
        """End the segment and sync; may be called twice."""
        with self._lock:
            self._end_segment()
        try:
            self.sync()
        finally:
            for segment in self._ended:
                segment.close()
            self._ended.clear()

    def _end_segment(self) -> None:
        """The caller holds the lock."""
        segment, self._segment = self._segment, None
        if segment is not None:
            segment.finish()
            self._ended.append(segment)


def _records(file: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """(opcode, offset, length) of every whole record; ends at a cut.

    Raises:
        ValueError: not a container; at least one byte is not where it should be.
    """
    if file.read(len(_MAGIC)) != _MAGIC:
        raise ValueError("no MCAP file")
    position = len(_MAGIC)
    while position + _RECORD.size <= size:
        file.seek(position)
        opcode, length = _RECORD.unpack(file.read(_RECORD.size))
        start = position + _RECORD.size
        if opcode == 0 or length > _MAX_RECORD:
            raise ValueError(f"record of kind {opcode} and {length} bytes at {position}")
        if start + length > size:
            raise ValueError(f"cut off in the record at {position}, the recorder was killed here")
        yield opcode, start, length
        if opcode == Opcode.FOOTER:
            return
        position = start + length
    raise ValueError("ends without a footer, the recorder was killed here")


def _channel(data: bytes) -> tuple[int, str, str]:
    """Number, topic and encoding of a channel record."""
    number, _ = struct.unpack_from("<HH", data)
    position, texts = 4, []
    for _ in range(2):
        (length,) = struct.unpack_from("<I", data, position)
        position += 4 + length
        if position > len(data):
            raise ValueError("channel record is damaged")
        texts.append(data[position - length : position].decode())
    return number, texts[0], texts[1]


def find_raw_frames(
    folder: Path, cameras: tuple[CameraEntry, ...], problems: list[str]
) -> list[list[RawFrame]]:
    """Whole frames of all segments, per camera in the order of recording.

    Args:
        folder: of the recording.
        cameras: of the manifest.
        problems: what was passed over is told here, in words.
    """
    found: list[dict[tuple[int, int], RawFrame]] = [{} for _ in cameras]
    place = folder / SEGMENTS_FOLDER
    paths = sorted(place.glob("*.mcap")) if place.is_dir() else []
    if not paths:
        problems.append(f"{place}: no segments")
    for path in paths:
        try:
            for camera, frame in _segment_frames(path, cameras):
                found[camera][frame.info.key] = frame
        except (ValueError, OSError, struct.error) as error:
            problems.append(f"{path}: {error}; what stands before is used")
    return [[frames[key] for key in sorted(frames)] for frames in found]


def _segment_frames(path: Path, cameras: tuple[CameraEntry, ...]) -> Iterator[tuple[int, RawFrame]]:
    topics = {
        f"{camera.camera_id}/{part}": (index, part)
        for index, camera in enumerate(cameras)
        for part in ("info", "pixels")
    }
    channels: dict[int, tuple[int, str]] = {}
    waiting: dict[int, FrameInfo] = {}
    with path.open("rb") as file:
        for opcode, offset, length in _records(file, os.fstat(file.fileno()).st_size):
            if opcode == Opcode.CHANNEL and length <= MAX_INFO_BYTES and len(channels) < _MAX_CHANNELS:
                file.seek(offset)
                number, topic, encoding = _channel(file.read(length))
                if topic.endswith("/pixels") and encoding != PIXEL_ENCODING:
                    raise ValueError(
                        f"pixels are encoded as {encoding[:60]!r}, expected {PIXEL_ENCODING!r}: read it with the version that recorded it"
                    )
                if topic in topics:
                    channels[number] = topics[topic]
            elif opcode == Opcode.MESSAGE and length >= _MESSAGE.size:
                file.seek(offset)
                number, sequence, _, _ = _MESSAGE.unpack(file.read(_MESSAGE.size))
                camera, part = channels.get(number, (-1, ""))
                body = length - _MESSAGE.size
                if part == "info" and body <= MAX_INFO_BYTES:
                    waiting[camera] = info_from_json(file.read(body))
                elif part == "pixels":
                    info = waiting.pop(camera, None)
                    if info is not None and info.sequence & 0xFFFFFFFF == sequence:
                        yield (
                            camera,
                            RawFrame(info=info, path=path, offset=offset + _MESSAGE.size, length=body),
                        )


def read_raw_frame(frame: RawFrame, camera: CameraEntry) -> NDArray[np.float16]:
    """Read a frame's pixels, (H, W, 4) float16, bit for bit as they were recorded.

    Raises:
        AssetError: damaged, or not the picture that the manifest describes.
    """
    where = f"{frame.path}: frame {frame.info.sequence} of camera {camera.camera_id}"
    # Compressed data of a picture are never much longer than the picture.
    if frame.length > 9 * camera.height * camera.width + 4096:
        raise AssetError(f"{where}: {frame.length} bytes, too many for {camera.width} x {camera.height}")
    try:
        with frame.path.open("rb") as file:
            file.seek(frame.offset)
            data = file.read(frame.length)
    except OSError as error:
        raise AssetError(f"{where}: cannot be read ({error.strerror})") from error
    return unpack_picture(data, camera.height, camera.width, where)
