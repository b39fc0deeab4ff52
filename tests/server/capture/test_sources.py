"""Simulated and recorded cameras."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from structlog.testing import capture_logs

from nearfield_server.capture.exr_sequence import INDEX_NAME, ExrSequence, ExrSequenceSource
from nearfield_server.capture.lab_source import LabCamera, LabSource, Timeline
from nearfield_server.capture.sensor_model import SensorModel
from nearfield_server.errors import AssetError, CaptureError
from nearfield_server.scene.exr import write_exr

SECOND = 1_000_000_000
SCALES = np.array([[2.0, 1.0, 0.5], [0.25, 0.0, 3.0]])


@pytest.fixture
def basis(tmp_path: Path) -> tuple[tuple[Path, ...], np.ndarray]:
    pictures = np.random.default_rng(1).uniform(0, 10, (2, 6, 4, 3)).astype(np.float16)
    paths = tuple(tmp_path / f"light{light}.exr" for light in range(2))
    for path, picture in zip(paths, pictures, strict=True):
        write_exr(path, picture)
    return paths, pictures.astype(np.float64)


def _camera(paths: tuple[Path, ...], **changes: object) -> LabCamera:
    fields: dict[str, object] = {
        "camera_id": "0",
        "basis_files": paths,
        "light_scales": SCALES,
        "height": 6,
        "width": 4,
    }
    return LabCamera(**{**fields, **changes})  # type: ignore[arg-type]


def test_picture_is_the_weighted_sum_of_the_basis(basis: tuple[tuple[Path, ...], np.ndarray]) -> None:
    paths, pictures = basis
    source = LabSource(_camera(paths))
    source.open()
    for weights in [(1.0, 1.0), (0.0, 2.5), (0.0, 0.0)]:
        source.set_light_weights(weights)
        frame = source.next_frame(5)
        assert frame is not None
        expected = np.einsum("k,kc,khwc->hwc", np.array(weights), SCALES, pictures)
        np.testing.assert_allclose(frame.pixels, expected, rtol=3e-7, atol=1e-6)


def test_revision_changes_exactly_with_the_weights(basis: tuple[tuple[Path, ...], np.ndarray]) -> None:
    source = LabSource(_camera(basis[0]))
    source.open()
    revisions = []
    for weights in [(1.0, 1.0), (1.0, 1.0), (0.5, 1.0), (0.5, 1.0), (1.0, 1.0)]:
        source.set_light_weights(weights)
        frame = source.next_frame(0)
        assert frame is not None
        revisions.append(frame.content_revision)
    assert revisions == [1, 1, 2, 2, 3]


def test_timeline_runs_on_the_absolute_clock_and_multiplies(
    basis: tuple[tuple[Path, ...], np.ndarray],
) -> None:
    paths, pictures = basis
    timeline = Timeline(weights=np.array([[1.0, 0.0], [0.0, 1.0], [2.0, 2.0]]), frame_rate=10.0)
    source = LabSource(_camera(paths, timeline=timeline))
    source.set_light_weights((1.0, 0.5))
    source.open()
    for now_ns in (0, 150_000_000, 250_000_000, 3 * SECOND + 50_000_000):
        frame = source.next_frame(now_ns)
        assert frame is not None
        weights = timeline.weights[(now_ns // 100_000_000) % 3] * [1.0, 0.5]
        np.testing.assert_allclose(
            frame.pixels, np.einsum("k,kc,khwc->hwc", weights, SCALES, pictures), rtol=3e-7, atol=1e-6
        )


def test_a_noisy_camera_never_repeats_a_frame(basis: tuple[tuple[Path, ...], np.ndarray]) -> None:
    source = LabSource(_camera(basis[0], sensor=SensorModel(full_well_radiance=5.0)))
    source.open()
    frames = [source.next_frame(0) for _ in range(3)]
    assert [f.content_revision for f in frames if f] == [1, 2, 3]
    assert frames[0] is not None
    assert frames[1] is not None
    assert (frames[0].pixels != frames[1].pixels).any()
    assert frames[0].counters["saturated"] > 0


def test_lab_faults_are_told_in_words(basis: tuple[tuple[Path, ...], np.ndarray], tmp_path: Path) -> None:
    paths, _ = basis
    with pytest.raises(CaptureError, match="before open"):
        LabSource(_camera(paths)).next_frame(0)
    with pytest.raises(CaptureError, match="1 basis pictures for 2 lights"):
        LabSource(_camera(paths[:1])).open()
    with pytest.raises(CaptureError, match="camera 0 says"):
        LabSource(_camera(paths, height=7)).open()
    with pytest.raises(AssetError, match="no such file"):
        LabSource(_camera((*paths[:1], tmp_path / "none.exr"))).open()
    with pytest.raises(CaptureError, match="3 light weights for 2 lights"):
        LabSource(_camera(paths)).set_light_weights((1.0, 1.0, 1.0))


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    for number in range(4):
        write_exr(tmp_path / f"{number:06d}.exr", np.full((3, 5, 3), number, np.float16))
    return tmp_path


def _sequence(folder: Path, **changes: object) -> ExrSequence:
    fields: dict[str, object] = {
        "camera_id": "c",
        "folder": folder,
        "frame_rate": 10.0,
        "height": 3,
        "width": 5,
    }
    return ExrSequence(**{**fields, **changes})  # type: ignore[arg-type]


def _value(source: ExrSequenceSource, seconds: float) -> float | None:
    frame = source.next_frame(7 * SECOND + round(seconds * SECOND))
    return None if frame is None else float(frame.pixels[0, 0, 0])


def test_frames_play_at_the_rate_and_late_callers_skip(recording: Path) -> None:
    source = ExrSequenceSource(_sequence(recording))
    source.open()
    assert [_value(source, t) for t in (0.0, 0.05, 0.11, 0.35, 0.39)] == [0, 0, 1, 3, 3]
    assert [_value(source, t) for t in (0.41, 0.75, 4.01)] == [0, 3, 0]


def test_without_loop_the_recording_ends_in_silence(recording: Path) -> None:
    source = ExrSequenceSource(_sequence(recording, loop=False))
    source.open()
    assert [_value(source, t) for t in (0.0, 0.35, 0.41, 9.0)] == [0, 3, None, None]


def test_the_index_gives_order_and_times(recording: Path) -> None:
    times = [("000002.exr", 10**18), ("000000.exr", 10**18 + SECOND), ("000001.exr", 10**18 + 3 * SECOND)]
    lines = [json.dumps({"file": name, "timestamp_ns": str(stamp)}) for name, stamp in times]
    (recording / INDEX_NAME).write_text("\n".join(lines) + "\n")
    source = ExrSequenceSource(_sequence(recording))
    source.open()
    assert [_value(source, t) for t in (0.0, 0.9, 1.1, 2.9, 3.1, 5.1)] == [2, 2, 0, 0, 1, 2]


def test_a_truncated_frame_is_dropped_counted_and_told_once_and_the_rest_plays(recording: Path) -> None:
    damaged = recording / "000001.exr"
    damaged.write_bytes(damaged.read_bytes()[:-20])
    source = ExrSequenceSource(_sequence(recording))
    source.open()
    with capture_logs() as logs:
        values = [_value(source, t) for t in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)]
    assert values == [0, None, 2, 3, 0, None, 2]
    assert len(logs) == 1
    assert "000001.exr" in logs[0]["reason"]
    assert source.describe()["unreadable_files"] == 2


def test_revisions_tell_frames_apart(recording: Path) -> None:
    source = ExrSequenceSource(_sequence(recording))
    source.open()
    frames = [source.next_frame(t) for t in (0, 50_000_000, 100_000_000, 400_000_000)]
    assert [frame.content_revision for frame in frames if frame] == [1, 1, 2, 3]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("{", "expected"),
        ('{"file": "a.exr"}', "expected"),
        ('{"file": "../a.exr", "timestamp_ns": "1"}', "not the name"),
    ],
)
def test_a_malformed_index_is_refused_with_its_line(recording: Path, line: str, words: str) -> None:
    (recording / INDEX_NAME).write_text('{"file": "000000.exr", "timestamp_ns": "1"}\n' + line + "\n")
    with pytest.raises(AssetError, match=f"{INDEX_NAME}:2.*{words}"):
        ExrSequenceSource(_sequence(recording)).open()


def test_an_index_whose_writer_was_killed_plays_up_to_the_cut(recording: Path) -> None:
    whole = '{"file": "000000.exr", "timestamp_ns": "1"}\n'
    (recording / INDEX_NAME).write_text(
        whole + whole.strip().replace("000000", "000001").replace('"1"', '"2')[:-9]
    )
    source = ExrSequenceSource(_sequence(recording))
    with capture_logs() as logs:
        source.open()
    assert source.describe()["frames"] == 1
    assert "middle of a line" in logs[0]["event"]


def test_missing_and_empty_folders_are_told_in_words(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="does not exist"):
        ExrSequenceSource(_sequence(tmp_path / "none")).open()
    with pytest.raises(CaptureError, match=r"no \*\.exr"):
        ExrSequenceSource(_sequence(tmp_path)).open()
