"""Recorded while it runs, and replayed: the same light, packet for packet, whatever happens to the recorder."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.service.harness import PATIENCE_S, Service

from nearfield_protocol.codec import SetLightWeight, SetObjectPose
from nearfield_server.recording.check import check_identity
from nearfield_server.recording.export import verify_frames
from nearfield_server.recording.files.library import open_recording
from nearfield_server.supervisor.control_socket import RunningService

pytestmark = pytest.mark.service


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service whose cameras never deliver the same picture twice."""
    service = Service(tmp_path_factory.mktemp("noisy") / "service.log", "--full-well", "20", "--rate", "15")
    try:
        service.running()
        yield service
    finally:
        assert service.close() == 0


def _recording(service: Service) -> dict[str, Any]:
    return dict(service._statuses.get("recorder", {}))


def _ask(service: Service, **request: Any) -> dict[str, Any]:
    return RunningService(service.pid("supervisor")).ask(request)


def _disturb(service: Service, step: int) -> None:
    """Move the object and switch lamps, as users do."""
    x = 0.3 + 0.02 * (step % 5)
    service.request(
        SetObjectPose(sequence=1, object_index=0, position=(x, 0.5, 0.4), quaternion=(0.0, 0.0, 0.0, 1.0))
    )
    service.request(SetLightWeight(sequence=1, light_index=step % 2, weight=0.25 + 0.25 * (step % 4)))


def _wait_for_updates(service: Service, take: int, count: int) -> None:
    step = 0

    def enough() -> bool:
        found = _recording(service)
        return bool(found.get("take") == take and found["light_updates"] >= count)

    while not enough():
        _disturb(service, step)
        step += 1
        with service._changed:
            service._changed.wait_for(enough, timeout=0.3)
        assert step < PATIENCE_S / 0.3, service.log_text()[-4000:]


def test_a_recording_gives_the_same_packets_though_its_recorder_was_killed(
    noisy: Service, tmp_path: Path
) -> None:
    folder = tmp_path / "recording"
    _ask(noisy, command="record", folder=str(folder), kind="raw")
    _wait_for_updates(noisy, 1, 12)
    light_before = noisy.newest_packet().sequence
    os.kill(noisy.pid("recorder"), signal.SIGKILL)
    _wait_for_updates(noisy, 2, 12)
    assert noisy.newest_packet().sequence > light_before
    _ask(noisy, command="finish")
    end = time.monotonic() + PATIENCE_S
    while (found := _ask(noisy, command="status"))["running"]:
        assert time.monotonic() < end
        time.sleep(0.1)
    assert found["recording"]["state"] == "ended"
    assert found["recording"]["warning"] == ""
    recording = open_recording(folder)
    assert not any(verify_frames(recording))
    assert [take.number for take in recording.manifest.takes] == [1, 2]
    assert recording.manifest.takes[0].ended_ns == 0
    assert recording.manifest.takes[1].reason == "ended as asked"
    report = check_identity(folder)
    assert report.is_identical, report.lines()
    assert report.runs == 2
    assert report.updates >= 24
    # Users did things meanwhile: objects moved in the recording.
    poses = {
        step.objects[0].revision for run in recording.light_runs([]) for step in run.updates if step.objects
    }
    assert len(poses) > 3
    _without_a_frame(folder)


def _without_a_frame(folder: Path) -> None:
    """The comparison notices a lost frame, and a light that is another one."""
    log = folder / "light.jsonl"
    whole = log.read_text()
    lines = whole.splitlines(keepends=True)
    position = next(index for index, line in enumerate(lines) if '"number":5' in line)
    packets = [line for line in lines if '"packet"' in line]
    other = packets[-1].split('"packet":"')[1].split('"')[0]
    changed = lines[position].split('"packet":"')
    if len(changed) == 2:
        lines[position] = changed[0] + '"packet":"' + other + changed[1][changed[1].index('"') :]
        log.write_text("".join(lines))
        report = check_identity(folder)
        assert not report.is_identical
        assert "first difference in take 1, run 1, update 5: sequence" in report.difference
    log.write_text(whole)
    segment = min((folder / "segments").iterdir())
    data = segment.read_bytes()
    segment.write_bytes(data[: len(data) // 2])
    report = check_identity(folder)
    assert not report.is_identical
    assert "identity is lost from update" in report.lost[0]
    assert report.packets_equal > 0
    segment.write_bytes(data)


def test_the_command_records_and_the_folder_is_a_room(noisy: Service, tmp_path: Path) -> None:
    """Through the command line, as OpenEXR files; then served as a room, where the pictures of that time give light again."""
    folder = tmp_path / "exr"
    done = subprocess.run(
        [
            *(
                sys.executable,
                "-m",
                "nearfield_server",
                "record",
                str(Path(_ask(noisy, command="status")["room_path"])),
            ),
            *("--out", str(folder), "--seconds", "1"),
        ],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "MB/s if every picture changes" in done.stderr
    recording = open_recording(folder)
    assert min(len(track.frames) for track in recording.tracks) > 5
    assert not any(verify_frames(recording))
    replayed = Service(tmp_path / "replay.log", room=folder)
    try:
        replayed.running()
        source = replayed.status("cam1", connected=True)["source"]
        assert source["kind"] == "recording"
        assert source["frames"] == len(recording.tracks[1].frames)
        at, _ = replayed.packet_after(0.0)
        _, packet = replayed.packet_after(at)
        assert packet.object_sh[0, 0].min() > 0
    finally:
        assert replayed.close() == 0


def test_a_command_that_makes_no_sense_is_refused_in_words(noisy: Service, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("")
    for arguments, words in (
        (["--out", str(tmp_path / "full")], "new or empty"),
        (["--out", str(tmp_path / "x"), "--format", "avi"], "expected one of exr, raw"),
        ([], "expected --out"),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "nearfield_server", "record", *arguments],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
        assert done.returncode == 2
        assert words in done.stderr
