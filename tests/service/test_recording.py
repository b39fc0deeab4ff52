"""Recorded while it runs, and replayed: the same light, packet for packet, whatever happens to the recorder."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests import network_namespace
from tests.service.harness import PATIENCE_S, TINY_ROOM, Service

from nearfield_protocol.codec import SetLightWeight, SetObjectPose
from nearfield_server.capture.cameras import make_source
from nearfield_server.recording.check import check_identity
from nearfield_server.recording.export import verify_frames
from nearfield_server.recording.files.library import open_recording
from nearfield_server.scene.room_config import load_room
from nearfield_server.supervisor.control_socket import RunningService

pytestmark = pytest.mark.service

SLOW_DISK = Path(__file__).parent / "slow_disk"


@pytest.fixture(scope="module")
def delay(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file; while it exists, every write of a recorder waits as many seconds as it says."""
    return tmp_path_factory.mktemp("disk") / "delay"


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory, delay: Path) -> Iterator[Service]:
    """A service whose cameras never deliver the same picture twice."""
    folder = tmp_path_factory.mktemp("noisy")
    slow_disk = {"PYTHONPATH": str(SLOW_DISK), "NEARFIELD_TESTS_SLOW_DISK": str(delay)}
    # A room of its own: `nearfield record ROOM` finds a service by its room, and other tests may serve the same one at this moment.
    room = shutil.copytree(TINY_ROOM, folder / "room")
    service = Service(folder / "service.log", "--full-well", "20", "--rate", "10", room=room, **slow_disk)
    try:
        service.running()
        yield service
    finally:
        assert service.close() == 0


def _recording(service: Service) -> dict[str, Any]:
    return dict(service._statuses.get("recorder", {}))


def _ask(service: Service, **request: Any) -> dict[str, Any]:
    return RunningService(service.pid("supervisor")).ask(request)


def _seen(service: Service, condition: Callable[[dict[str, Any]], Any], what: str) -> dict[str, Any]:
    """What the page is told of the recorder, as soon as it is so."""
    end = time.monotonic() + PATIENCE_S
    while True:
        status = service.api_status()
        recorder: dict[str, Any] = status["processes"].get("recorder", {})
        if "state" in recorder and condition(recorder):
            assert not status["light"]["is_stale"]
            return recorder
        assert time.monotonic() < end, f"{what} was not seen: {recorder}"
        time.sleep(0.1)


def _end_recording(service: Service) -> dict[str, Any]:
    _ask(service, command="finish")
    end = time.monotonic() + PATIENCE_S
    while (found := _ask(service, command="status"))["running"]:
        assert time.monotonic() < end
        time.sleep(0.1)
    recording: dict[str, Any] = found["recording"]
    return recording


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
    _wait_for_updates(noisy, 1, 10)
    light_before = noisy.newest_packet().sequence
    os.kill(noisy.pid("recorder"), signal.SIGKILL)
    _wait_for_updates(noisy, 2, 10)
    assert noisy.newest_packet().sequence > light_before
    found = _end_recording(noisy)
    assert found["state"] == "ended"
    assert found["warning"] == ""
    recording = open_recording(folder)
    assert not any(verify_frames(recording))
    assert [take.number for take in recording.manifest.takes] == [1, 2]
    assert recording.manifest.takes[0].ended_ns == 0
    assert recording.manifest.takes[1].reason == "ended as asked"
    report = check_identity(folder)
    assert report.is_identical, report.lines()
    assert report.runs == 2
    assert report.updates >= 20
    # Users did things meanwhile: objects moved in the recording.
    poses = {
        step.objects[0].revision for run in recording.light_runs([]) for step in run.updates if step.objects
    }
    assert len(poses) > 3
    # The comparison notices light that is another one, and a lost frame.
    log = (folder / "light.jsonl").read_text()
    _spoil_packet(folder)
    report = check_identity(folder)
    assert not report.is_identical
    assert "first difference in take 1, run 1, update 5: sequence" in report.difference
    assert 0 < report.packets_equal < report.packets
    (folder / "light.jsonl").write_text(log)
    _cut_first_take(folder)
    report = check_identity(folder)
    assert not report.is_identical
    assert "take 1, run 1: identity is lost from update" in report.lost[0]
    assert "was not recorded" in report.lost[0]
    assert 0 < report.updates_checked < report.updates


def _spoil_packet(folder: Path) -> None:
    """Put the last packet in the place of the fifth."""
    log = folder / "light.jsonl"
    lines = log.read_text().splitlines(keepends=True)
    other = json.loads([line for line in lines if '"packet"' in line][-1])["packet"]
    position = next(index for index, line in enumerate(lines) if '"number":5' in line)
    lines[position] = json.dumps({**json.loads(lines[position]), "packet": other}) + "\n"
    log.write_text("".join(lines))


def _cut_first_take(folder: Path) -> None:
    segment = min((folder / "segments").iterdir())
    segment.write_bytes(segment.read_bytes()[: segment.stat().st_size * 2 // 3])


def test_a_slow_disk_costs_recorded_frames_that_are_counted_and_no_light(
    noisy: Service, delay: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "slow"
    _ask(noisy, command="record", folder=str(folder), kind="raw", queue_bytes=1_000_000)
    _wait_for_updates(noisy, 1, 3)
    frames = noisy.status("cam0")["frames"]
    delay.write_text("0.2")
    try:
        recorder = _seen(noisy, lambda found: found["frames_dropped"] >= 20, "dropped frames")
        assert re.search(
            r"\d+ frames were not recorded: the disk or the processor is too slow", recorder["warning"]
        )
        assert not recorder["fault"]
        assert recorder["queue_mb"] <= 1.0
        noisy.packet_after(time.monotonic())
        assert noisy.wait("more frames", lambda: noisy.status("cam0")["frames"] > frames + 10)
    finally:
        delay.unlink()
    dropped = _end_recording(noisy)["frames_dropped"]
    recording = open_recording(folder)
    assert not any(verify_frames(recording))
    [take] = recording.manifest.takes
    assert take.frames_dropped == dropped >= 20
    # What is there gives the light of that time; where a frame is missing that it was made of, that is said.
    report = check_identity(folder)
    assert not report.difference, report.lines()
    assert report.packets_equal == report.packets > 0


def test_a_full_disk_ends_the_recording_in_words_and_no_light(noisy: Service, tmp_path: Path) -> None:
    if reason := network_namespace.why_no_mounts():
        pytest.skip(f"a small disk cannot be made: {reason}")
    disk = tmp_path / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "none", str(disk)], check=True, timeout=60)
    try:
        folder = disk / "full"
        _ask(noisy, command="record", folder=str(folder), kind="raw", reserve_bytes=0)
        recorder = _seen(noisy, lambda found: found["state"] == "stopped", "the end of the recording")
        assert "recording stopped: the disk is full" in recorder["fault"]
        assert recorder["fault"] in recorder["warning"]
        noisy.packet_after(time.monotonic())
        written = _end_recording(noisy)["frames_written"]
        recording = open_recording(folder)
        assert not any(verify_frames(recording))
        assert sum(len(track.frames) for track in recording.tracks) == written > 3
        report = check_identity(folder)
        assert not report.difference, report.lines()
        assert report.packets_equal == report.packets > 0
    finally:
        subprocess.run(["umount", str(disk)], check=True, timeout=60)
    # Nothing of it stays: the next recording begins as usual, and ends as asked though it has hardly begun.
    _ask(noisy, command="record", folder=str(tmp_path / "next"), kind="raw")
    found = _end_recording(noisy)
    assert (found["state"], found["warning"], found["folder"]) == ("ended", "", str(tmp_path / "next"))


def test_the_command_records_and_the_folder_is_a_room(noisy: Service, tmp_path: Path) -> None:
    """Through the command line, as OpenEXR files; each camera of that room shows the pictures of that time."""
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
    assert min(len(track.frames) for track in recording.tracks) > 3
    assert not any(verify_frames(recording))
    room = load_room(folder)
    for index, track in enumerate(recording.tracks):
        source = make_source(room, index, {})
        source.open()
        frame = source.next_frame(1)
        assert frame is not None
        np.testing.assert_array_equal(
            frame.pixels.view(np.uint16), track.read(track.frames[0]).view(np.uint16)
        )
