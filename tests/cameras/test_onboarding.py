"""Finding and checking cameras that really are GigE Vision devices."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import typer
from click.testing import Result
from tests.cameras.harness import CameraProcess, in_place_of, write_device_room
from tests.network_namespace import camera_address
from tests.service.harness import TINY_ROOM
from typer.testing import CliRunner

from nearfield_server.capture.aravis.library import load
from nearfield_server.commands.cameras import cameras
from nearfield_server.commands.doctor import doctor
from nearfield_server.errors import ConfigError
from nearfield_server.onboarding.connected import Listing, list_connected
from nearfield_server.onboarding.finder import ThisMachinesFinder
from nearfield_server.onboarding.gige import ask_camera
from nearfield_server.onboarding.opening import open_camera
from nearfield_server.onboarding.session import SetupSession
from nearfield_server.onboarding.viewer import Wish
from nearfield_server.scene.room_config import load_room

pytestmark = pytest.mark.cameras
SIDE = 128


@pytest.fixture(scope="module")
def pair() -> Iterator[tuple[CameraProcess, CameraProcess]]:
    """Two cameras; another program controls the second."""
    free = CameraProcess(TINY_ROOM, "0", camera_address(94))
    taken = CameraProcess(TINY_ROOM, "1", camera_address(95))
    try:
        free.ready()
        taken.ready()
        c = load().c
        own, other = (
            c.g_inet_address_new_from_string(address.encode()) for address in ("127.0.0.1", taken.address)
        )
        device = c.arv_gv_device_new(own, other)
        yield free, taken
        load().unref(device)
    finally:
        free.close()
        taken.close()


@pytest.fixture
def free(pair: tuple[CameraProcess, CameraProcess]) -> CameraProcess:
    return pair[0]


@pytest.fixture
def taken(pair: tuple[CameraProcess, CameraProcess]) -> CameraProcess:
    return pair[1]


def nearfield(command: Callable[..., None], *arguments: str | Path) -> Result:
    app = typer.Typer()
    app.command()(command)
    return CliRunner().invoke(app, [*map(str, arguments)])


def test_cameras_on_an_interface_and_at_addresses(free: CameraProcess, taken: CameraProcess) -> None:
    found = nearfield(
        cameras, "--interface", "lo", "--address", free.address, "--address", taken.address, "--json"
    )
    assert found.exit_code == 0, found.output
    listed = {camera["place"]: camera for camera in json.loads(found.stdout)["cameras"]}
    assert listed[free.address]["serial"] == free.serial
    assert listed[free.address]["state"] == "free"
    assert listed[taken.address]["state"] == "in use"
    assert (listed[free.address]["width"], listed[free.address]["height"]) == (SIDE, SIDE)
    assert {"Mono8", "BayerRG12p"} <= set(listed[free.address]["pixel_formats"])


def test_the_doctor_of_a_room_of_real_cameras(
    free: CameraProcess, taken: CameraProcess, tmp_path: Path
) -> None:
    sources = [
        {"kind": "aravis", "address": camera.address, "pixel_format": "BayerRG12p"}
        for camera in (free, taken)
    ]
    room = write_device_room(tmp_path, TINY_ROOM, in_place_of(TINY_ROOM, sources))
    first, second = (camera.camera_id for camera in load_room(room).cameras)
    told = json.loads(nearfield(doctor, room, "--json", "--port", "0").stdout)
    levels = {finding["check"]: finding["level"] for finding in told["findings"]}
    assert levels[f"camera {first}"] == "ok"
    assert levels[f"camera {second}"] == "warning"
    assert levels["libaravis"] == levels["receive buffer"] == levels["link lo"] == "ok"


def test_a_room_is_written_from_what_the_cameras_see(
    free: CameraProcess, taken: CameraProcess, tmp_path: Path
) -> None:
    lab = load_room(TINY_ROOM)
    truth = lab.cameras[0].intrinsics
    model = tmp_path / "models" / "tiny.glb"
    model.parent.mkdir()
    model.write_bytes(lab.model_path.read_bytes())
    addresses = ["--address", free.address, "--address", taken.address]
    degrees = str(math.degrees(2 * truth.theta_max))
    path = tmp_path / "room.toml"
    arguments = [*addresses, "--write-room", path, "--model", model, "--field", degrees]
    result = nearfield(cameras, *arguments)
    assert result.exit_code == 0, result.output
    assert "image circle found" in result.stdout, result.stdout
    assert f"{taken.address}): left out, in use" in result.stdout
    (camera,) = load_room(path).cameras
    assert (camera.intrinsics.width, camera.intrinsics.height) == (truth.width, truth.height)
    assert camera.intrinsics.fx == pytest.approx(truth.fx, rel=0.03)
    assert (camera.intrinsics.cx, camera.intrinsics.cy) == pytest.approx((truth.cx, truth.cy), abs=1.5)
    # The camera was let go.
    assert ask_camera(free.address).is_controlled is False
    again = nearfield(cameras, *arguments)
    assert isinstance(again.exception, ConfigError)
    assert "no free camera was found" in str(again.exception)


def test_looking_through_a_camera_follows_the_exposure(free: CameraProcess, tmp_path: Path) -> None:
    def search() -> Listing:
        return list_connected(ThisMachinesFinder(), addresses=[free.address])

    session = SetupSession(search, open_camera, tmp_path / "room.toml")
    try:
        session.search()
        looks = [session.look(0, Wish(exposure_s=exposure_s)) for exposure_s in (0.05, 0.2)]
        assert [look.exposure_s for look in looks] == pytest.approx([0.05, 0.2], rel=1e-3)
        assert looks[1].bright == pytest.approx(4 * looks[0].bright, rel=0.1)
        assert looks[1].saturated_share < 0.05
        free.tell(picture="saturated")
        assert session.look(0, Wish()).saturated_share > 0.95
        free.tell(picture="live")
        assert ask_camera(free.address).is_controlled is True
    finally:
        session.close()
    assert ask_camera(free.address).is_controlled is False
