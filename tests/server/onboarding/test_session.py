"""A set-up from the search to the written room."""

from __future__ import annotations

import math

import pytest

from nearfield_server.errors import CaptureError, ConfigError
from nearfield_server.onboarding.session import CameraChoice
from nearfield_server.onboarding.viewer import Wish
from nearfield_server.scene.device_schema import AravisSourceTable
from nearfield_server.scene.room_config import load_room

from .conftest import Lab


def test_what_was_seen_is_what_is_written(lab: Lab) -> None:
    look = lab.session.look(0, Wish(exposure_s=0.02))
    assert (look.width, look.height, look.pixel_format, look.exposure_s) == (120, 100, "BayerRG12p", 0.02)
    assert look.has_circle
    choice = CameraChoice(index=0, camera_id="door", exposure_s=0.02, field_degrees=200.0)
    assert lab.session.models() == ("room.glb",)
    room = lab.session.write([choice], model=lab.folder / "room.glb")
    assert room.name == "living room"
    lens = load_room(lab.folder).cameras[0].intrinsics
    assert lens.theta_max == pytest.approx(math.radians(100), abs=1e-6)
    assert (lens.cx, lens.cy, lens.fx * lens.theta_max) == pytest.approx((60, 50, 40), abs=1)
    source = room.sources[0]
    assert isinstance(source, AravisSourceTable)
    assert (str(source.address), source.pixel_format, source.exposure_s) == (
        "192.168.10.21",
        "BayerRG12p",
        0.02,
    )


def test_cameras_are_added_to_a_room_that_is_there(lab: Lab) -> None:
    assert not lab.session.room().exists
    lab.session.write([CameraChoice(index=0, camera_id="cam0")], name="lab", model=lab.folder / "room.glb")
    before = (lab.folder / "room.toml").read_text()
    state = lab.session.room()
    assert (state.exists, state.camera_ids, state.places) == (True, ("cam0",), ("192.168.10.21",))
    lab.session.look(1, Wish())
    room = lab.session.write([CameraChoice(index=1, camera_id="cam1", pixel_format="Mono8")])
    assert [camera.camera_id for camera in room.cameras] == ["cam0", "cam1"]
    assert (lab.folder / "room.toml").read_text().startswith(before)
    replaced = lab.session.write(
        [CameraChoice(index=1, camera_id="only")], name="new", model=lab.folder / "room.glb", overwrite=True
    )
    assert [camera.camera_id for camera in replaced.cameras] == ["only"]


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ([], "no camera is chosen"),
        ([CameraChoice(index=9, camera_id="cam0")], "search again"),
        ([CameraChoice(index=1, camera_id="cam0")], "look through it first"),
        ([CameraChoice(index=3, camera_id="cam0")], "none of its pixel formats can be read"),
        ([CameraChoice(index=0, camera_id="cam0", pixel_format="RGB8")], "expected one of its pixel formats"),
        ([CameraChoice(index=0, camera_id="cam 0")], "cameras"),
    ],
)
def test_what_cannot_be_written(lab: Lab, choices: list[CameraChoice], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        lab.session.write(choices, model=lab.folder / "room.glb")
    with pytest.raises(ConfigError, match="no model is chosen" if len(choices) == 1 else message):
        lab.session.write([CameraChoice(index=0, camera_id="cam0")] if choices else [])
    assert not (lab.folder / "room.toml").exists()


def test_cameras_that_cannot_be_looked_through_say_why(lab: Lab) -> None:
    with pytest.raises(CaptureError, match=r"192\.168\.10\.22 is in use"):
        lab.session.look(2, Wish())
    with pytest.raises(ConfigError, match="none of its pixel formats can be read"):
        lab.session.look(3, Wish())
    lab.broken.add("23:Mono8")
    with pytest.raises(CaptureError, match="unplugged"):
        lab.session.look(1, Wish())
    lab.broken.clear()
    assert lab.session.look(1, Wish()).pixel_format == "Mono8"


def test_a_camera_is_open_once_whatever_is_asked_of_it(lab: Lab) -> None:
    lab.session.look(0, Wish())
    lab.session.look(1, Wish())
    assert sorted(lab.open_now) == ["192.168.10.21:BayerRG12p", "23:Mono8"]
    assert lab.session.look(0, Wish(), "Mono8").pixel_format == "Mono8"
    assert sorted(lab.open_now) == ["192.168.10.21:Mono8", "23:Mono8"]
    lab.session.search()
    assert lab.open_now == []
    assert lab.searches == 2


def test_a_broken_room_file_is_told_and_left_alone(lab: Lab) -> None:
    (lab.folder / "room.toml").write_text("cameras = [")
    state = lab.session.room()
    assert state.exists
    assert "not valid TOML" in state.problem
    with pytest.raises(ConfigError, match="not valid TOML"):
        lab.session.write([CameraChoice(index=0, camera_id="cam0")], model=lab.folder / "room.glb")


def test_an_exposure_that_suits_is_found(lab: Lab) -> None:
    # The disc is a bit more than a third of the picture: its signal is 20 per second.
    look = lab.session.expose(0)
    assert look.bright == pytest.approx(0.4, rel=0.1)
    assert look.exposure_s == pytest.approx(0.02, rel=0.1)
    short = lab.session.expose(0, longest_s=0.005)
    assert short.exposure_s == 0.005


def test_models_called_room_are_proposed_first(lab: Lab) -> None:
    (lab.folder / "objects").mkdir()
    for name in ("bunny.glb", "objects/dragon.glb", "notes.txt"):
        (lab.folder / name).touch()
    assert lab.session.models() == ("room.glb", "bunny.glb", "objects/dragon.glb")
    assert lab.session.model_path("bunny.glb") == lab.folder / "bunny.glb"
    assert lab.session.model_path("") is None
    with pytest.raises(ConfigError, match="expected a model in the folder"):
        lab.session.model_path("../secret.glb")
