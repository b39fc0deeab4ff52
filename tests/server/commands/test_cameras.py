"""`nearfield cameras` with a finder that is made up."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import httpx
import numpy as np
import pytest
import typer
from tests.server.onboarding.conftest import Lab
from typer.testing import CliRunner

from nearfield_server.commands import cameras as command
from nearfield_server.errors import ConfigError
from nearfield_server.onboarding.connected import Connected, Details
from nearfield_server.onboarding.session import CameraChoice
from nearfield_server.scene.room_config import load_room


class FakeFinder:
    asked: tuple[str, ...] = ()

    def on_interface(self, interface: str) -> Sequence[Connected]:
        FakeFinder.asked += (interface,)
        return [Connected(kind="gige", place="192.168.10.21", vendor="Maker", model="Eye")]

    def at_address(self, address: str) -> Connected:
        FakeFinder.asked += (address,)
        return Connected(kind="gige", place=address)

    def on_usb(self) -> Sequence[Connected]:
        return []

    def video(self) -> Sequence[Connected]:
        return []

    def details(self, camera: Connected) -> Details:
        return Details(width=1024, height=768, pixel_formats=("BayerRG12p",))


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(command, "ThisMachinesFinder", FakeFinder)
    monkeypatch.setattr(FakeFinder, "asked", ())
    app = typer.Typer()
    app.command()(command.cameras)
    return lambda *arguments: CliRunner().invoke(app, list(arguments))


def test_nothing_is_asked_without_being_named(run) -> None:
    result = run()
    assert result.exit_code == 0
    assert FakeFinder.asked == ()
    assert "No camera found." in result.stdout
    assert "--interface enp3s0" in result.stdout


def test_named_interfaces_and_addresses(run) -> None:
    result = run("--interface", "enp3s0", "--interface", "enp4s0", "--address", "10.0.0.5")
    assert FakeFinder.asked == ("enp3s0", "enp4s0", "10.0.0.5")
    assert "Maker Eye" in result.stdout
    assert "1024 x 768" in result.stdout
    assert "--interface enp3s0" not in result.stdout
    told = json.loads(run("--address", "10.0.0.5", "--json").stdout)
    assert told["cameras"][0]["place"] == "10.0.0.5"
    assert told["cameras"][0]["pixel_formats"] == ["BayerRG12p"]


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    made = Lab(tmp_path)
    yield made
    made.session.close()


def test_all_free_cameras_are_written(lab: Lab) -> None:
    text = command.write_all(lab.session, model=lab.folder / "room.glb", name="lab", field_degrees=190.0)
    assert (
        "Maker Eye (192.168.10.21): cam0, image circle found in 120 x 100 pixels, exposed for 20 ms" in text
    )
    assert "Other Look (23): cam1, image circle found" in text
    assert "192.168.10.22 (192.168.10.22): left out, in use" in text
    assert "24 (24): left out, free. none of its pixel formats can be read" in text
    assert "written; 2 cameras" in text
    room = load_room(lab.folder)
    assert [camera.intrinsics.theta_max for camera in room.cameras] == pytest.approx([np.radians(95)] * 2)
    assert [source.exposure_s for source in room.sources] == [0.02, 0.02]  # type: ignore[union-attr]
    assert lab.open_now != []
    lab.session.close()
    assert lab.open_now == []


def test_what_the_room_has_is_not_written_again(lab: Lab) -> None:
    lab.session.write([CameraChoice(index=0, camera_id="door")], name="lab", model=lab.folder / "room.glb")
    text = command.write_all(lab.session, model=None)
    assert "Maker Eye (192.168.10.21): is in the room already" in text
    assert "added to; 2 cameras" in text
    assert [camera.camera_id for camera in load_room(lab.folder).cameras] == ["door", "cam0"]
    before = (lab.folder / "room.toml").read_text()
    with pytest.raises(ConfigError, match="no free camera was found"):
        command.write_all(lab.session, model=None)
    assert (lab.folder / "room.toml").read_text() == before
    command.write_all(lab.session, model=lab.folder / "room.glb", overwrite=True)
    assert [camera.camera_id for camera in load_room(lab.folder).cameras] == ["cam0", "cam1"]


def test_a_camera_that_fails_keeps_its_place_if_its_size_is_known(lab: Lab) -> None:
    lab.broken |= {"192.168.10.21:BayerRG12p"}
    text = command.write_all(lab.session, model=lab.folder / "room.glb")
    assert "cam0, lens unknown, because it could not be looked through: 192.168.10.21" in text
    assert load_room(lab.folder).cameras[0].intrinsics.width == 120


def test_rooms_that_cannot_be_written(lab: Lab, run, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="needs --model"):
        command.write_all(lab.session, model=None)
    (lab.folder / "room.toml").write_text("cameras = [")
    with pytest.raises(ConfigError, match="not valid TOML"):
        command.write_all(lab.session, model=None)
    result = run("--setup", "--write-room", str(tmp_path / "room.toml"))
    assert isinstance(result.exception, ConfigError)


def test_the_page_is_served_until_it_is_stopped(lab: Lab, capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[int] = []

    def look_and_stop() -> None:
        url = capsys.readouterr().out.split()[3]
        seen.append(httpx.get(url + "api/setup").status_code)
        raise KeyboardInterrupt

    command.serve_page(lab.session, 0, look_and_stop)
    assert seen == [200]
