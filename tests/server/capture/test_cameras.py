"""From room files to sources."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nearfield_calibration.fisheye import unproject
from nearfield_calibration.models import FisheyeIntrinsics
from nearfield_server.capture.cameras import image_circle, load_timeline, make_source
from nearfield_server.capture.device_source import DeviceSource
from nearfield_server.capture.exr_sequence import ExrSequenceSource
from nearfield_server.capture.lab_source import LabSource
from nearfield_server.errors import ConfigError
from nearfield_server.scene.bundle import load_bundle
from nearfield_server.scene.device_schema import AravisSourceTable, V4l2SourceTable
from nearfield_server.scene.exr import write_exr
from nearfield_server.scene.room_config import ExrSequenceSourceConfig, RoomConfig, load_room

TINY_ROOM = Path(__file__).parents[2] / "data" / "tiny_room"


@pytest.fixture(scope="module")
def room() -> RoomConfig:
    return load_room(TINY_ROOM)


def test_the_image_circle_ends_at_theta_max() -> None:
    lens = FisheyeIntrinsics(
        width=41, height=31, fx=14.0, fy=13.0, cx=20.0, cy=15.0, k=(0.02, 0.0, 0.0, 0.0), theta_max=1.2
    )
    circle = image_circle(lens)
    rows, columns = np.mgrid[0:31, 0:41]
    # Independent of the lens code: the pixels' normalised radius against r(theta_max).
    radius = np.hypot((columns - 20.0) / 14.0, (rows - 15.0) / 13.0)
    np.testing.assert_array_equal(circle, radius <= 1.2 * (1 + 0.02 * 1.2**2))
    assert unproject(np.array([20.0, 15.0]), lens)[1]


def test_a_bundle_gives_lab_cameras_that_show_its_pictures(room: RoomConfig) -> None:
    for index, camera in enumerate(room.cameras):
        source = make_source(room, index, {})
        assert isinstance(source, LabSource)
        source.open()
        source.set_light_weights((0.0,) * len(room.lights))
        dark = source.next_frame(0)
        assert dark is not None
        assert not dark.pixels.any()
        source.set_light_weights(tuple(light.weight for light in room.lights))
        lit = source.next_frame(0)
        assert lit is not None
        assert lit.pixels.shape == (camera.intrinsics.height, camera.intrinsics.width, 3)
        assert lit.pixels.max() > 0
        source.close()


def test_a_timeline_is_the_sequence_of_the_bundle(room: RoomConfig) -> None:
    sequence = load_bundle(TINY_ROOM).sequences[0]
    timeline = load_timeline(room, sequence.name)
    np.testing.assert_array_equal(timeline.at(0), sequence.weights[0])
    np.testing.assert_array_equal(timeline.at(round(1.5e9 / sequence.fps)), sequence.weights[1])
    with pytest.raises(ConfigError, match=f"there are.*{sequence.name}"):
        load_timeline(room, "none such")


def test_only_bundles_have_timelines(room: RoomConfig, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="only bundles"):
        load_timeline(replace(room, folder=tmp_path), "flicker")


def test_cameras_have_noise_of_their_own(room: RoomConfig) -> None:
    options = {"sensor": {"full_well_radiance": 5.0}}
    frames = []
    for index in (0, 1):
        same_picture = replace(room, sources=(room.sources[0], room.sources[0]))
        source = make_source(same_picture, index, options)
        source.open()
        frames.append(source.next_frame(0))
    assert frames[0] is not None
    assert frames[1] is not None
    assert (frames[0].pixels != frames[1].pixels).any()


def test_recordings_play_at_the_rate_of_the_room(room: RoomConfig, tmp_path: Path) -> None:
    lens = room.cameras[0].intrinsics
    write_exr(tmp_path / "000.exr", np.ones((lens.height, lens.width, 3), np.float16))
    recorded = replace(room, sources=(ExrSequenceSourceConfig(folder=tmp_path), *room.sources[1:]))
    source = make_source(recorded, 0, {})
    assert isinstance(source, ExrSequenceSource)
    assert source.sequence.frame_rate == room.frame_rate
    source.open()
    assert source.next_frame(0) is not None


@pytest.mark.parametrize("kind", ["aravis", "v4l2"])
def test_devices_are_asked_for_the_rate_of_the_command_line(room: RoomConfig, kind: str) -> None:
    table = (
        AravisSourceTable(kind="aravis", address="127.0.0.9", exposure_s=0.01)
        if kind == "aravis"
        else V4l2SourceTable(kind="v4l2", path="/dev/video9", exposure_s=0.01)
    )
    real = replace(room, sources=(table, *room.sources[1:]))
    for options, rate in (
        ({}, room.frame_rate),
        ({"frame_rate": None}, room.frame_rate),
        ({"frame_rate": 7.5}, 7.5),
    ):
        source = make_source(real, 0, options)
        assert isinstance(source, DeviceSource)
        assert source._camera.frame_rate == rate
        assert source._device._frame_rate == rate  # type: ignore[attr-defined]
