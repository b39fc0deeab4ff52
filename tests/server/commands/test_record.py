"""What `nearfield record`, `replay` and `recording` refuse, and what they say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from tests.server.recording.conftest import make_recording
from typer.testing import CliRunner

from nearfield_server.commands.record import record
from nearfield_server.commands.recording import app, export
from nearfield_server.commands.replay import replay
from nearfield_server.commands.serve import recording_options
from nearfield_server.errors import AssetError, ConfigError

__all__ = ["make_recording"]


def test_a_recording_needs_a_new_folder_and_a_known_format(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("")
    with pytest.raises(ConfigError, match="expected --out"):
        record(None)
    with pytest.raises(ConfigError, match="new or empty"):
        record(None, out=tmp_path / "full", kind="raw")
    with pytest.raises(ConfigError, match="expected one of exr, raw"):
        record(None, out=tmp_path / "x", kind="avi")
    assert recording_options(tmp_path / "y", "raw") == {"folder": str(tmp_path / "y"), "kind": "raw"}


def test_only_recordings_with_frames_are_replayed(
    tmp_path: Path, make_recording: Callable[..., Path]
) -> None:
    with pytest.raises(AssetError, match="no recording here"):
        replay(tmp_path)
    with pytest.raises(ConfigError, match="--backend"):
        replay(tmp_path, backend="vulkan")
    with pytest.raises(ConfigError, match="holds no frame"):
        replay(make_recording("raw", count=0))


def test_a_recording_is_described_verified_and_exported(
    tmp_path: Path, make_recording: Callable[..., Path]
) -> None:
    folder = make_recording("raw")
    runner = CliRunner()
    told = runner.invoke(app, ["info", str(folder)])
    assert "camera right.2: 4 frames of 10 x 6 in 0.3 s, 10.00 frames/s" in told.stdout
    assert "not ended by itself" in told.stdout
    assert runner.invoke(app, ["verify", str(folder)]).exit_code == 0
    exported = runner.invoke(app, ["export", str(folder), "--to", str(tmp_path / "exr")])
    assert exported.exit_code == 0, exported.output
    assert len(list((tmp_path / "exr").rglob("*.exr"))) == 8
    (tmp_path / "exr" / "frames" / "left" / "0001_0000000002.exr").write_bytes(b"")
    found = runner.invoke(app, ["verify", str(tmp_path / "exr")])
    assert found.exit_code == 1
    assert "7 of 8 frames are whole" in found.stdout
    again = runner.invoke(app, ["export", str(folder), "--to", str(tmp_path / "exr")])
    assert isinstance(again.exception, ConfigError)


def test_an_export_goes_into_a_folder_of_its_own(tmp_path: Path, make_recording: Callable[..., Path]) -> None:
    folder = make_recording("raw")
    (tmp_path / "file").write_text("")
    before = sorted(folder.rglob("*"))
    for to, words in (
        (tmp_path / "file", "new or empty"),
        (folder, "outside of the recording"),
        (folder / "room" / "exr", "outside of the recording"),
    ):
        with pytest.raises(ConfigError, match=words):
            export(folder, to)
    assert sorted(folder.rglob("*")) == before


def test_verify_fails_where_frames_are_missing(make_recording: Callable[..., Path]) -> None:
    runner = CliRunner()
    missing = make_recording("exr", name="missing")
    (missing / "frames" / "left" / "0001_0000000002.exr").unlink()
    cut = make_recording("raw", name="cut")
    segment = next(cut.rglob("*.mcap"))
    segment.write_bytes(segment.read_bytes()[: segment.stat().st_size // 2])
    gone = make_recording("raw", name="gone")
    next(gone.rglob("*.mcap")).unlink()
    empty = make_recording("exr", name="empty", count=0)
    for folder in (missing, cut, gone, empty):
        assert runner.invoke(app, ["verify", str(folder)]).exit_code == 1, folder.name
    told = runner.invoke(app, ["verify", str(missing)])
    assert "0001_0000000002.exr is missing" in told.output
