"""Both formats: bit-exact, readable by other tools, and tolerant of all that a killed recorder leaves behind."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import random
import shutil
import struct
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from tests.server.recording.conftest import CAMERAS, HEIGHT, WIDTH, info, picture

from nearfield_server.capture.exr_sequence import ExrSequence, ExrSequenceSource
from nearfield_server.errors import AssetError
from nearfield_server.recording.export import export_exr, verify_frames
from nearfield_server.recording.files.exr_store import ExrWriter
from nearfield_server.recording.files.library import open_recording
from nearfield_server.recording.files.manifest import Kind
from nearfield_server.recording.files.raw_store import RawWriter, find_raw_frames

BOTH = pytest.mark.parametrize("kind", ["exr", "raw"])
MakeRecording = Callable[..., Path]


def _assert_whole(folder: Path, count: int) -> None:
    recording = open_recording(folder)
    for camera, track in enumerate(recording.tracks):
        assert [frame.info.sequence for frame in track.frames] == list(range(1, count + 1))
        for frame in track.frames:
            assert frame.info == info(frame.info.sequence, frame.info.timestamp_ns)
            np.testing.assert_array_equal(
                track.read(frame).view(np.uint16), picture(100 * camera + frame.info.sequence).view(np.uint16)
            )


@BOTH
def test_every_bit_and_every_word_comes_back(make_recording: MakeRecording, kind: Kind) -> None:
    folder = make_recording(kind)
    _assert_whole(folder, 4)
    assert open_recording(folder).problems == ()
    assert list(verify_frames(open_recording(folder))) == [""] * 8


def test_ordinary_tools_open_the_exr_files(make_recording: MakeRecording) -> None:
    folder = make_recording("exr")
    path = folder / "frames" / "right.2" / "0001_0000000003.exr"
    file = OpenEXR.File(str(path))
    np.testing.assert_array_equal(
        file.channels()["RGBA"].pixels.view(np.uint16), picture(103).view(np.uint16)
    )
    header = file.header()
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    assert (
        int(header["nearfield.timestampNs"]) == open_recording(folder).tracks[1].frames[2].info.timestamp_ns
    )
    assert int(header["nearfield.timestampNs"]) > 2**53  # what neither a double nor an int of EXR can hold
    assert header["nearfield.calibration"] == "fedcba9876543210"
    assert header["nearfield.camera"] == "right.2"
    assert header["nearfield.exposures_s"] == "0.001 0.1"
    assert header["nearfield.device_ns"] == "12345678901234567890"
    assert header["expTime"] == pytest.approx(0.1)
    assert "0x3BFF" in header["nearfield.alpha"]


def test_the_source_of_exr_sequences_plays_a_camera_of_a_recording(make_recording: MakeRecording) -> None:
    folder = make_recording("exr") / "frames" / "left"
    source = ExrSequenceSource(
        ExrSequence(camera_id="left", folder=folder, frame_rate=1.0, height=HEIGHT, width=WIDTH)
    )
    source.open()
    for sequence in range(1, 5):
        frame = source.next_frame(10**9 + (sequence - 1) * 100_000_000)
        assert frame is not None
        np.testing.assert_array_equal(frame.pixels, picture(sequence)[..., :3].astype(np.float32))


def test_the_library_of_mcap_reads_the_segments(make_recording: MakeRecording) -> None:
    [path] = (make_recording("raw") / "segments").iterdir()
    with path.open("rb") as stream:
        found = [(channel.topic, message) for _, channel, message in make_reader(stream).iter_messages()]
    assert len(found) == 16
    facts = [json.loads(message.data) for topic, message in found if topic == "left/info"]
    assert [fields["sequence"] for fields in facts] == [1, 2, 3, 4]
    assert [message.log_time for topic, message in found if topic == "left/pixels"] == [
        int(fields["timestamp_ns"]) for fields in facts
    ]


def test_frames_go_into_segments_while_the_disk_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits, may_return, descriptors = threading.Event(), threading.Event(), []

    def hang(fd: int) -> None:
        descriptors.append(os.readlink(f"/proc/self/fd/{fd}"))
        waits.set()
        assert may_return.wait(60)

    writer = RawWriter(tmp_path, CAMERAS, 1, segment_bytes=1500)
    writer.write(0, info(1, 1), picture(1))
    with monkeypatch.context() as patched:
        patched.setattr(os, "fdatasync", hang)
        syncer = threading.Thread(target=writer.sync)
        syncer.start()
        assert waits.wait(60)
        for number in range(2, 6):  # past the end of the segment that the disk still has in hand
            writer.write(0, info(number, number), picture(number))
        may_return.set()
        syncer.join()
        writer.close()
    paths = sorted(str(path) for path in (tmp_path / "segments").iterdir())
    assert len(paths) > 2
    assert sorted(set(descriptors)) == paths
    found = find_raw_frames(tmp_path, CAMERAS, [])
    assert [frame.info.sequence for frame in found[0]] == [1, 2, 3, 4, 5]


def test_a_segment_that_the_disk_refuses_is_waited_for_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_fd: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    writer = RawWriter(tmp_path, CAMERAS, 1, segment_bytes=100)
    for number in (1, 2, 3):
        writer.write(0, info(number, number), picture(number))
    with monkeypatch.context() as patched:
        patched.setattr(os, "fdatasync", refuse)
        with pytest.raises(OSError, match="Input/output"):
            writer.sync()
    synced: list[int] = []
    with monkeypatch.context() as patched:
        patched.setattr(os, "fdatasync", synced.append)
        writer.close()
    assert len(synced) == len(list((tmp_path / "segments").iterdir())) == 3


def test_pixels_in_an_unknown_encoding_are_refused_in_words(make_recording: MakeRecording) -> None:
    folder = make_recording("raw")
    [path] = (folder / "segments").iterdir()
    path.write_bytes(path.read_bytes().replace(b"nearfield.half4+blosc", b"nearfield.half4+later"))
    recording = open_recording(folder)
    assert recording.num_frames == 0
    assert "'nearfield.half4+later', expected 'nearfield.half4+blosc'" in recording.problems[0]


def test_segments_end_by_size_and_time_and_join_without_a_seam(
    tmp_path: Path, make_recording: MakeRecording
) -> None:
    folder = make_recording("raw", count=1)
    shutil.rmtree(folder / "segments")
    by_size = RawWriter(folder, CAMERAS, 1, segment_bytes=1500)
    for sequence in range(1, 5):
        for camera in range(2):
            by_size.write(camera, info(sequence, sequence), picture(100 * camera + sequence))
    by_size.close()
    assert len(list((folder / "segments").iterdir())) > 2
    _assert_whole(folder, 4)
    shutil.rmtree(folder / "segments")
    by_time = RawWriter(folder, CAMERAS, 1, segment_s=2.5)
    for sequence in range(1, 5):
        by_time.write(0, info(sequence, sequence * 10**9), picture(sequence))
    by_time.close()
    assert len(list((folder / "segments").iterdir())) == 2
    assert [frame.info.sequence for frame in open_recording(folder).tracks[0].frames] == [1, 2, 3, 4]


def test_a_segment_cut_anywhere_gives_back_every_frame_before_the_cut(make_recording: MakeRecording) -> None:
    folder = make_recording("raw")
    [path] = (folder / "segments").iterdir()
    whole = path.read_bytes()
    ends = sorted(
        frame.offset + frame.length
        for track in open_recording(folder).tracks
        for frame in track.frames  # type: ignore[union-attr]
    )
    rng = random.Random(1)
    for cut in [0, 5, *ends, *(rng.randrange(len(whole)) for _ in range(40))]:
        path.write_bytes(whole[:cut])
        recording = open_recording(folder)
        assert recording.num_frames == sum(end <= cut for end in ends)
        assert any("killed" in problem or "no MCAP" in problem for problem in recording.problems)
        assert not any(verify_frames(recording))
        if cut < 8:
            continue
        # The library agrees, read from the begin; it gives up on the cut itself.
        seen = 0
        with path.open("rb") as stream, contextlib.suppress(McapError, EOFError, struct.error):
            for _, channel, _ in NonSeekingReader(stream).iter_messages(log_time_order=False):
                seen += channel.topic.endswith("/pixels")
        assert seen == recording.num_frames


def test_an_index_cut_anywhere_gives_back_every_whole_line(make_recording: MakeRecording) -> None:
    folder = make_recording("exr")
    path = folder / "frames" / "left" / "index.jsonl"
    whole = path.read_bytes()
    ends = [
        position
        for position, byte in enumerate(whole)
        if byte == ord("}") and whole[position + 1 :][:1] == b"\n"
    ]
    for cut in range(0, len(whole), 13):
        path.write_bytes(whole[:cut])
        recording = open_recording(folder)
        assert len(recording.tracks[0].frames) == sum(end < cut for end in ends)
        assert len(recording.tracks[1].frames) == 4
        assert not any(verify_frames(recording))


@BOTH
def test_the_next_take_goes_on_behind_a_cut(make_recording: MakeRecording, kind: Kind) -> None:
    folder = make_recording(kind)
    if kind == "raw":
        [path] = (folder / "segments").iterdir()
        path.write_bytes(path.read_bytes()[:-900])
        writer: RawWriter | ExrWriter = RawWriter(folder, CAMERAS, 2)
    else:
        path = folder / "frames" / "left" / "index.jsonl"
        path.write_bytes(path.read_bytes()[:-20])
        (folder / "frames" / "left" / ".0001_0000000005.exr.tmp").write_bytes(b"half a fr")
        writer = ExrWriter(folder, CAMERAS)
    writer.write(0, info(1, 7, take=2), picture(50))
    writer.close()
    recording = open_recording(folder)
    assert recording.problems
    keys = [frame.info.key for frame in recording.tracks[0].frames]
    assert keys[0] == (1, 1)
    assert keys[-1] == (2, 1)
    np.testing.assert_array_equal(
        recording.tracks[0].read(recording.tracks[0].frames[-1]).view(np.uint16), picture(50).view(np.uint16)
    )


def test_export_is_the_same_recording(make_recording: MakeRecording, tmp_path: Path) -> None:
    recording = open_recording(make_recording("raw"))
    assert list(export_exr(recording, tmp_path / "exr")) == [""] * 8
    _assert_whole(tmp_path / "exr", 4)
    assert open_recording(tmp_path / "exr").manifest.takes == recording.manifest.takes


@pytest.mark.parametrize(
    "line",
    [
        "null",
        "[]",
        "[" * 100_000,
        '{"file":"../../etc/passwd","take":1,"sequence":9,"content_revision":"1","timestamp_ns":"1"}',
        '{"file":"0001_0000000009.exr","take":1,"sequence":9,"content_revision":"1","timestamp_ns":"1"}',
        '{"file":"0001_0000000001.exr","take":1,"sequence":1,"content_revision":"1","timestamp_ns":"-5"}',
        '{"file":"0001_0000000001.exr","take":1,"sequence":1e300,"content_revision":"1","timestamp_ns":"1"}',
        '{"file":"0001_0000000001.exr","take":true,"sequence":1,"content_revision":"1","timestamp_ns":"1"}',
        '{"take":1,"sequence":1,"content_revision":"1","timestamp_ns":"99999999999999999999999"}',
        '{"file":"0001_0000000001.exr","take":1,"sequence":1,"content_revision":"1","timestamp_ns":"1","counters":[]}',
        "\udcff\x00",
    ],
)
def test_a_hostile_index_line_is_passed_over_and_told(make_recording: MakeRecording, line: str) -> None:
    folder = make_recording("exr")
    path = folder / "frames" / "left" / "index.jsonl"
    path.write_bytes(line.encode("utf-8", "surrogateescape") + b"\n" + path.read_bytes())
    recording = open_recording(folder)
    assert len(recording.problems) == 1
    assert "index.jsonl:1:" in recording.problems[0]
    assert len(recording.tracks[0].frames) == 4


def test_a_hostile_segment_is_told_and_allocates_nothing(make_recording: MakeRecording) -> None:
    folder = make_recording("raw")
    [path] = (folder / "segments").iterdir()
    whole = path.read_bytes()
    rng = random.Random(2)
    for _ in range(150):
        damaged = bytearray(whole)
        for _ in range(rng.choice([1, 1, 8])):
            damaged[rng.randrange(len(damaged))] = rng.choice([0, 255, rng.randrange(256)])
        path.write_bytes(damaged)
        recording = open_recording(folder)
        words = list(verify_frames(recording))
        assert recording.num_frames <= 8
        assert all(isinstance(word, str) for word in words)
    for length in (1 << 62, (1 << 32) + 5):
        path.write_bytes(whole[:8] + b"\x05" + length.to_bytes(8, "little") + b"x" * 50)
        assert open_recording(folder).num_frames == 0


def test_a_damaged_exr_file_is_told(make_recording: MakeRecording) -> None:
    folder = make_recording("exr")
    names = sorted((folder / "frames" / "left").glob("*.exr"))
    names[0].write_bytes(names[0].read_bytes()[:-30])
    names[1].write_bytes(b"no picture")
    shutil.copyfile(_other_size(folder), names[2])
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": np.zeros((HEIGHT, WIDTH, 3), np.float32)}).write(
        str(names[3])
    )
    words = list(verify_frames(open_recording(folder)))
    assert [bool(word) for word in words] == [True] * 4 + [False] * 4
    assert "damaged" in words[0]
    assert "not an OpenEXR file" in words[1]
    assert "expected 10 x 6" in words[2]
    assert "half-float" in words[3]


def _other_size(folder: Path) -> Path:
    path = folder / "other.exr"
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGBA": np.zeros((3, 3, 4), np.float16)}).write(str(path))
    return path


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": 2}, "format"),
        ({"kind": "avi"}, "kind"),
        ({"cameras": []}, "at least one camera"),
        ({"cameras": [{"id": "../x", "height": 1, "width": 1, "calibration_id": ""}]}, "no name"),
        ({"cameras": [{"id": "x", "height": 10**9, "width": 1, "calibration_id": ""}]}, "sides"),
        ({"cameras": 5}, "recording.json"),
        ({"frame_rate": -1}, "frame_rate"),
        ({"frame_rate": "x"}, "recording.json"),
        ({"takes": [{"number": "1"}]}, "takes"),
        ({"room_name": None}, ""),
    ],
)
def test_a_hostile_manifest_is_refused_in_words(
    make_recording: MakeRecording, change: dict[str, object], words: str
) -> None:
    folder = make_recording("exr")
    path = folder / "recording.json"
    body = json.loads(path.read_text())
    path.write_text(json.dumps({**body, **change}))
    if words:
        with pytest.raises(AssetError, match=words):
            open_recording(folder)
    else:
        open_recording(folder)
    path.write_text("{")
    with pytest.raises(AssetError, match=r"recording\.json"):
        open_recording(folder)
    os.unlink(path)
    with pytest.raises(AssetError, match="no recording here"):
        open_recording(folder)
