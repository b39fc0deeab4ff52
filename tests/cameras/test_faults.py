"""Every fault that cameras have, done to a running service: what its users see, and that it heals by itself.

Four cameras of the tiny room; most faults happen to the second one, and the others are witnesses that nothing else stops.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cameras.harness import CameraProcess, wait_until
from tests.cameras.rig import Rig, is_live, num_threads, open_descriptors, running_rig
from tests.service.harness import TINY_ROOM, child_pids, is_alive

from nearfield_server.capture.aravis.gvcp import PORT

pytestmark = [pytest.mark.cameras, pytest.mark.service, pytest.mark.timeout(300)]

VICTIM = 1
NAME = f"cam{VICTIM}"
EXPOSURE_S = 0.05
FORMAT = "BayerRG12p"
DELAYS_FILE = "NEARFIELD_FAULT_DELAYS"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    folder = tmp_path_factory.mktemp("faults")
    names = ["0", "1", "0", "1"]
    # Small packets: a picture of 128 x 128 pixels then takes 18 of them, and a lossy link spoils some pictures and not others.
    keys = {"frame_rate": 10.0, "atlas_size": 256, "source": {"packet_size": 1400}}
    with running_rig(folder, TINY_ROOM, names, 0, EXPOSURE_S, **keys) as running:
        running.service.running()
        yield running
        if path := os.environ.get(DELAYS_FILE):
            with Path(path).open("a") as file:
                file.write(json.dumps(running.delays) + "\n")


@pytest.fixture(autouse=True)
def nothing_is_left(rig: Rig) -> Iterator[None]:
    """Before and after each fault all is well, the same processes run, and the supervisor holds the same files and shared memory."""
    rig.all_well()
    before = kept(rig)
    yield
    rig.all_well()
    rig.service.wait("the same files, processes and shared memory", lambda: kept(rig) == before)


def kept(rig: Rig) -> tuple[int, int, list[str]]:
    """What a service keeps while it runs: files of the supervisor, its children, shared memory files."""
    rig.service.spare()
    supervisor = int(rig.service.status("supervisor")["pid"])
    return open_descriptors(supervisor), len(child_pids(supervisor)), sorted(os.listdir("/dev/shm"))


def is_lost(status: dict[str, Any]) -> dict[str, Any] | None:
    """The victim's entry once it is called lost in words, its light is stale and tells its age, and all others are live."""
    camera, light = status["cameras"][VICTIM], status["light"]
    others = [entry for index, entry in enumerate(status["cameras"]) if index != VICTIM]
    seen = (
        camera["state"] == "lost"
        and camera["fault"]
        and light["is_stale"]
        and light["camera_ages_s"][VICTIM] > 1.0
        and all(is_live(entry) for entry in others)
    )
    return camera if seen else None


def warning(words: str) -> Callable[[dict[str, Any]], str | None]:
    """Finds a warning of the victim that has these words."""
    return lambda status: next(
        (text for text in status["cameras"][VICTIM]["warnings"] if words in text), None
    )


def total_light(rig: Rig) -> float:
    """Irradiance that the newest light packet brings to the object, all channels, without its direction."""
    return float(np.sum(rig.service.packet_after(time.monotonic())[1].object_sh[0, 0]))


def loses_and_finds(
    rig: Rig, fault: str, inject: Callable[[], None], heal: Callable[[], None]
) -> dict[str, Any]:
    """Inject a fault that silences the victim, see it reported while light goes on, heal it; returns the victim's entry when lost."""
    started = time.time()
    inject()
    camera = rig.until(f"{NAME} lost", is_lost)
    rig.note_delay(f"{fault}: detected", started, NAME, "camera failed")
    rig.service.packet_after(time.monotonic())
    heal()
    healed = time.time()
    rig.all_well()
    rig.note_delay(f"{fault}: delivers after the cause is gone", healed, NAME, "camera delivers")
    found: dict[str, Any] = camera
    return found


def is_set_as_the_room_file_says(rig: Rig) -> bool:
    report = rig.cameras[VICTIM].tell()
    exposure = report["exposure_us"] == pytest.approx(1e6 * EXPOSURE_S)
    return bool(exposure and report["pixel_format"] == FORMAT and report["is_controlled"])


def reconnects(status: dict[str, Any]) -> int:
    return int(status["cameras"][VICTIM]["reconnects"])


def test_a_pulled_cable(rig: Rig) -> None:
    before = reconnects(rig.seen())
    cable = rig.cables[VICTIM]
    try:
        lost = loses_and_finds(rig, "cable pulled", cable.pull, cable.plug)
    finally:
        cable.plug()
    assert rig.cameras[VICTIM].address in lost["fault"] or NAME in lost["fault"]
    rig.until("the reconnection counted", lambda status: reconnects(status) > before)


def test_a_rebooted_camera_gets_its_settings_again(rig: Rig) -> None:
    camera = rig.cameras[VICTIM]

    def switch_on() -> None:
        camera.start()
        # What a camera has at power-on, before the service has found it.
        camera.ready()

    loses_and_finds(rig, "camera killed", camera.close, switch_on)
    assert is_set_as_the_room_file_says(rig)


def test_a_camera_that_hangs_and_goes_on(rig: Rig) -> None:
    camera = rig.cameras[VICTIM]
    loses_and_finds(rig, "camera frozen", camera.freeze, camera.thaw)
    assert is_set_as_the_room_file_says(rig)


def test_a_lossy_link_costs_pictures_that_are_counted_and_no_light(rig: Rig) -> None:
    before = rig.seen()["cameras"][VICTIM]
    rig.cameras[VICTIM].tell(loss=0.02)
    try:

        def broken_and_whole(status: dict[str, Any]) -> bool:
            camera = status["cameras"][VICTIM]
            broken = camera["frames_broken"] - before["frames_broken"]
            lost = camera["frames_lost"] - before["frames_lost"]
            return bool(broken + lost >= 5 and camera["frames"] >= before["frames"] + 10)

        rig.until("broken pictures counted and whole ones used", broken_and_whole)
    finally:
        rig.cameras[VICTIM].tell(loss=0.0)


def test_a_pixel_format_changed_by_someone_else_is_set_back(rig: Rig) -> None:
    before = reconnects(rig.seen())
    started = time.time()
    rig.cameras[VICTIM].tell(pixel_format="Mono8")
    rig.until("the camera opened again", lambda status: reconnects(status) > before)
    rig.all_well()
    rig.note_delay("pixel format changed: detected", started, NAME, "camera failed")
    rig.note_delay("pixel format changed: delivers again", started, NAME, "camera delivers")
    reasons = [fields["reason"] for at, fields in rig.events(NAME, "camera failed") if at > started]
    assert any("changed the camera" in reason and FORMAT in reason for reason in reasons)
    assert is_set_as_the_room_file_says(rig)


def test_a_camera_without_the_pixel_format_says_which_it_offers(rig: Rig) -> None:
    """Someone has put another camera in its place."""
    camera = rig.cameras[VICTIM]
    camera.restart("--formats", "Mono8,BayerRG8")
    try:
        lost = rig.until(
            "the camera lost",
            lambda status: (found := is_lost(status)) and FORMAT in found["fault"] and found,
        )
        assert "BayerRG8" in lost["fault"]
    finally:
        camera.restart()


def test_a_blinded_camera_gives_a_lower_bound_and_never_darkness(rig: Rig) -> None:
    light = total_light(rig)
    rig.cameras[VICTIM].tell(picture="saturated")
    try:
        rig.until("saturation in words", warning("saturated"))
        rig.until("the share", lambda status: status["cameras"][VICTIM]["saturated_share"] > 0.5)
        assert total_light(rig) > light
    finally:
        rig.cameras[VICTIM].tell(picture="live")
    rig.until("sight", lambda status: status["cameras"][VICTIM]["saturated_share"] < 0.1)
    wait_until("light as before", lambda: abs(total_light(rig) - light) < 0.1 * light)


def test_a_covered_camera_is_reported_and_stays_connected(rig: Rig) -> None:
    before = reconnects(rig.seen())
    rig.cameras[VICTIM].tell(picture="black")
    try:
        rig.until("blackness in words", warning("black"))
        assert is_live(rig.seen()["cameras"][VICTIM])
    finally:
        rig.cameras[VICTIM].tell(picture="live")
    assert reconnects(rig.all_well()) == before


def test_a_picture_that_stands_still_is_not_light(rig: Rig) -> None:
    noisy = rig.seen()["cameras"][VICTIM]["frames"] + 40
    rig.until("noise seen", lambda status: status["cameras"][VICTIM]["frames"] >= noisy)
    rig.cameras[VICTIM].tell(picture="frozen")
    try:
        rig.until("the frozen picture in words", warning("same picture"))
        rig.until("its age", lambda status: status["light"]["camera_ages_s"][VICTIM] > 1.0)
    finally:
        rig.cameras[VICTIM].tell(picture="live")


def test_an_exposure_changed_by_someone_else_is_set_back(rig: Rig) -> None:
    light = total_light(rig)
    rig.cameras[VICTIM].tell(ExposureTime=5000.0)
    rig.until("the change in words", warning("changed by someone else"))
    wait_until("the settings of the room file", lambda: is_set_as_the_room_file_says(rig))
    wait_until("light as before", lambda: abs(total_light(rig) - light) < 0.1 * light)


def test_a_clock_that_jumps_stops_nothing(rig: Rig) -> None:
    before = rig.seen()
    for offset_s in (3600, 0):  # an hour forward, and back
        start = rig.seen()
        jumps, frames = start["processes"][NAME]["source"]["clock_jumps"], start["cameras"][VICTIM]["frames"]
        # Only a clock that was known for a while can jump.
        rig.until(
            "a known clock", lambda status, least=frames + 25: status["cameras"][VICTIM]["frames"] > least
        )
        rig.cameras[VICTIM].tell(clock_offset_ns=offset_s * 10**9)
        status = rig.until(
            "the jump counted and pictures after it",
            lambda status, jumps=jumps, least=frames + 45: (
                status["processes"][NAME]["source"]["clock_jumps"] > jumps
                and status["cameras"][VICTIM]["frames"] > least
                and status
            ),
        )
        assert is_live(status["cameras"][VICTIM])
        assert reconnects(status) == reconnects(before)


def test_a_clock_that_runs_too_fast_is_followed(rig: Rig) -> None:
    """Three times faster than quartz ever does: the microseconds per second are found, and nothing of it is seen in the light."""
    camera = rig.cameras[VICTIM]
    before = rig.seen()["processes"][NAME]["source"]["clock_jumps"]
    camera.restart()
    camera.tell(clock_ppm=300.0)
    try:

        def is_followed(status: dict[str, Any]) -> dict[str, Any] | None:
            source = status["processes"][NAME]["source"]
            is_near = abs(source["clock_skew_ppm"] + 300.0) < 30.0
            return status if is_near and is_live(status["cameras"][VICTIM]) else None

        status = rig.until("the clock's speed", is_followed)
        assert status["processes"][NAME]["source"]["clock_jumps"] == before
        assert not status["light"]["is_stale"]
    finally:
        camera.restart()


def test_a_camera_that_another_program_has_taken_is_left_to_it_and_used_once_it_is_free(rig: Rig) -> None:
    camera = rig.cameras[VICTIM]
    camera.close()
    rig.until("the camera lost", is_lost)
    with control_taken_at_start(camera):
        lost = rig.until(
            "the other program in words",
            lambda status: (found := is_lost(status)) and "another program" in found["fault"] and found,
        )
        assert camera.address in lost["fault"]
    rig.all_well()
    assert is_set_as_the_room_file_says(rig)


@contextlib.contextmanager
def control_taken_at_start(camera: CameraProcess) -> Iterator[None]:
    """Switch a camera on and take it before the service does; its heartbeat stops at the end, and the camera sets itself free."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
        program.bind(("127.0.0.1", 0))
        program.settimeout(0.01)
        camera.start()
        wait_until("control of the camera", lambda: take_control(program, camera.address))
        stop = threading.Event()

        def heartbeat() -> None:
            while not stop.wait(0.2):
                take_control(program, camera.address)

        thread = threading.Thread(target=heartbeat)
        thread.start()
        try:
            camera.ready()
            yield
        finally:
            stop.set()
            thread.join()


def take_control(program: socket.socket, address: str) -> bool:
    """Write 2 to the control register of a camera (GigE Vision 2.0, 28); whether it was granted."""
    with contextlib.suppress(OSError):
        program.sendto(bytes([0x42, 1, 0, 0x82, 0, 8, 0, 1, 0, 0, 0x0A, 0, 0, 0, 0, 2]), (address, PORT))
        return program.recv(100)[:2] == b"\0\0"
    return False


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_dead_or_frozen_capture_process_is_replaced_by_the_one_in_reserve(
    rig: Rig, number: signal.Signals
) -> None:
    pids, spare = rig.service.running(), rig.service.spare()
    started = time.time()
    os.kill(pids[NAME], number)
    rig.until("the process in reserve at work", lambda status: status["processes"][NAME]["pid"] == spare)
    rig.all_well()
    fault = f"capture process {number.name}"
    found = next(at for at, fields in rig.events("supervisor", "process died") if at > started)
    rig.delays.setdefault(f"{fault}: detected", []).append(round(found - started, 3))
    rig.note_delay(f"{fault}: delivers after detection", found, NAME, "camera delivers")
    assert not is_alive(pids[NAME])
    after = rig.service.running()
    assert {name: pid for name, pid in after.items() if name != NAME} == {
        name: pid for name, pid in pids.items() if name != NAME
    }
    assert rig.seen()["cameras"][VICTIM]["restarts"] >= 1


def test_three_of_four_cameras_dead_and_light_still_follows_the_room(rig: Rig) -> None:
    for camera in rig.cameras[1:]:
        camera.close()
    try:

        def only_one_left(status: dict[str, Any]) -> bool:
            states = [camera["state"] for camera in status["cameras"]]
            return bool(states == ["live", "lost", "lost", "lost"] and status["light"]["is_stale"])

        rig.until("three cameras lost", only_one_left)
        light = total_light(rig)
        rig.cameras[0].tell(lights=[0.0, 0.0])
        wait_until("less light", lambda: total_light(rig) < 0.9 * light)
        rig.cameras[0].tell(lights=[1.0, 1.0])
        wait_until("light again", lambda: total_light(rig) > 0.95 * light)
    finally:
        for camera in rig.cameras[1:]:
            camera.start()
        for camera in rig.cameras[1:]:
            camera.ready()


def test_many_reconnections_leave_no_thread_and_no_file_behind(rig: Rig) -> None:
    camera, pid = rig.cameras[VICTIM], rig.service.running()[NAME]

    def reconnect() -> None:
        before = reconnects(rig.all_well())
        camera.restart()
        rig.until("the camera opened again", lambda status: reconnects(status) > before)
        rig.all_well()

    def held() -> tuple[int, int]:
        return num_threads(pid), open_descriptors(pid)

    reconnect()
    threads, files = held()
    for _ in range(2):
        reconnect()
    # What belonged to a dead camera is given back in the background, once its time limits are over.
    wait_until("what was held after the first", lambda: held()[0] <= threads and held()[1] <= files)
    assert rig.service.running()[NAME] == pid
