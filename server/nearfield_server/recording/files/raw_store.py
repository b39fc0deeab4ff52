"""Recorded frames in MCAP containers: cheap enough for full rate on a small machine.

Each frame is two messages of one time and sequence: `<camera>/info` (JSON, as in the other format) and `<camera>/pixels` (zstd of the
byte planes of the half floats, see `byte_planes`). Messages are not chunked: what was handed to the kernel is there, whatever happens
to the recorder. A segment ends after a minute or a gigabyte, and the disk has all of it then. A cut segment is read up to the cut.
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
from nearfield_server.recording.files.byte_planes import pack_picture, unpack_picture
from nearfield_server.recording.files.frame_info import MAX_INFO_BYTES, FrameInfo, info_from_json
from nearfield_server.recording.files.manifest import CameraEntry

SEGMENTS_FOLDER: Final = "segments"
SEGMENT_BYTES: Final = 1_000_000_000
SEGMENT_SECONDS: Final = 60.0
PIXEL_ENCODING: Final = "nearfield.halfplanes+zstd"
PIXEL_SCHEMA: Final = (
    "zstd of 8 byte planes of height * width bytes each: plane 2c holds the low bytes of channel c (red, green, blue, alpha) of "
    "little-endian half floats, plane 2c + 1 the high bytes; rows from the top. Alpha: 1 valid, 0 unknown, 0x3BFF lower bound."
)
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
        self._writer = Writer(
            _AllOrNothing(self._file),  # type: ignore[arg-type]
            compression=CompressionType.NONE,
            index_types=IndexType.NONE,
            use_chunking=False,
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

    @property
    def size(self) -> int:
        return self._file.tell()

    def add(self, camera: int, info: FrameInfo, packed: bytes) -> int:
        start = self.size
        sequence = info.sequence & 0xFFFFFFFF
        try:
            for channel, data in zip(self._channels[camera], (info.to_json().encode(), packed), strict=True):
                self._writer.add_message(channel, info.timestamp_ns, data, info.timestamp_ns, sequence)
        except OSError:
            # Nothing may stand behind half a record: it would be taken for its end.
            self._file.truncate(start)
            self._file.seek(start)
            raise
        return self.size - start

    def sync(self) -> None:
        os.fdatasync(self._file.fileno())

    def finish(self) -> None:
        try:
            with contextlib.suppress(OSError):  # a segment without its last lines is as good
                self._writer.finish()  # type: ignore[no-untyped-call]
            self.sync()
        finally:
            self._file.close()


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
        self._number = 0
        self._segment: _Segment | None = None

    def write(self, camera: int, info: FrameInfo, pixels: NDArray[np.float16]) -> int:
        """Write a frame (H, W, 4) and return its bytes on disk."""
        packed = pack_picture(pixels)
        with self._lock:
            segment = self._segment
            if segment is not None and (
                segment.size >= self._segment_bytes
                or info.timestamp_ns * 1e-9 - segment.started_s >= self._segment_s
            ):
                self._segment = None
                segment.finish()
                segment = None
            if segment is None:
                self._number += 1
                path = self._folder / f"{self._take:04d}_{self._number:05d}.mcap"
                segment = self._segment = _Segment(path, self._cameras, info.timestamp_ns * 1e-9)
            return segment.add(camera, info, packed)

    def sync(self) -> None:
        """Wait until the disk has everything written so far."""
        with self._lock:
            if self._segment is not None:
                self._segment.sync()

    def close(self) -> None:
        """End the segment; may be called twice."""
        with self._lock:
            segment, self._segment = self._segment, None
            if segment is not None:
                segment.finish()


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


def _channel_topic(data: bytes) -> tuple[int, str]:
    """Number and topic of a channel record."""
    number, _, length = struct.unpack_from("<HHI", data)
    topic = data[8 : 8 + length]
    if len(topic) != length:
        raise ValueError("channel record is damaged")
    return number, topic.decode()


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
                number, topic = _channel_topic(file.read(length))
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
