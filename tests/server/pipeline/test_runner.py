from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from nearfield_protocol.codec import VAL_DTYPE
from nearfield_server.errors import ConfigError, GraphicsError
from nearfield_server.pipeline.runner import STAGES, LightPipeline
from nearfield_server.records import CameraFrame, LightSettings, LightUpdate, ObjectPose, UnseenFill
from nearfield_server.reference.box_room import (
    BoxRoom,
    RadianceField,
    hide_texels,
    lamp_field,
    make_box_room,
)


class Ticks:
    """A clock that moves by one second per reading."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 1.0
        return self.now


class CountingProbes:
    def __init__(self, room: BoxRoom) -> None:
        self.room, self.calls = room, 0

    def trace(self, centre_world: np.ndarray, resolution: int = 32) -> np.ndarray:
        self.calls += 1
        return self.room.trace(centre_world, resolution)


def _pipeline(room: BoxRoom, **options: object) -> LightPipeline:
    settings = options.pop("settings", LightSettings())
    options.setdefault("backend", "cpu")
    options.setdefault("probe_rays", room)
    return LightPipeline(room.mesh(), room.texels, room.table, settings, **options)


def _frames(
    room: BoxRoom, field: RadianceField, revision: int = 1, noise: float = 0.0
) -> list[CameraFrame | None]:
    rng = np.random.default_rng(revision)
    frames: list[CameraFrame | None] = []
    for index in range(len(room.cameras)):
        pixels = room.picture(index, field)
        if noise:
            pixels[..., :3] *= rng.normal(1.0, noise, (*pixels.shape[:2], 3)).astype(np.float16)
        frames.append(
            CameraFrame(
                camera_index=index,
                sequence=revision,
                content_revision=revision,
                timestamp_ns=1000 * revision + index,
                pixels=pixels,
            )
        )
    return frames


def _ran(update: LightUpdate) -> set[str]:
    return {stage.name for stage in update.stages if stage.ran}


def test_a_full_update(room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]) -> None:
    pipeline = _pipeline(room)
    update = pipeline.update(_frames(room, two_lamps), poses)
    assert tuple(stage.name for stage in update.stages) == STAGES
    assert _ran(update) == set(STAGES)
    assert update.vals.dtype == VAL_DTYPE
    assert update.vals.shape == (16,)
    assert update.object_sh.shape == (2, 9, 3)
    assert update.timestamp_ns == 1000
    assert update.revision == 1
    assert update.counters["vals_used"] == 16.0
    radiance = pipeline.texel_radiance
    direct = np.where(radiance >= update.threshold, radiance, 0.0).astype(np.float64)
    energy = (direct * room.texels.area[:, None]).sum(axis=0)
    np.testing.assert_allclose(
        update.vals["radiant_intensity"].sum(axis=0, dtype=np.float64), energy, rtol=1e-6
    )
    np.testing.assert_allclose(np.linalg.norm(update.vals["normal"], axis=1), 1.0, rtol=1e-6)


@pytest.mark.parametrize("ratio", [None, 0.5, 0.9])
def test_equals_the_reference(
    room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose], ratio: float | None
) -> None:
    table = room.table
    # The same weights for both: the packed table rounds them, and the comparison is about the stages.
    table = replace(
        table,
        fraction_x=(np.rint(table.fraction_x.astype(np.float64) * 255) / 255).astype(np.float32),
        fraction_y=(np.rint(table.fraction_y.astype(np.float64) * 255) / 255).astype(np.float32),
        weight=(np.rint(table.weight.astype(np.float64) * 65535).clip(1) / 65535).astype(np.float32),
    )
    rounded = replace(room, table=table)
    settings = LightSettings(split_ratio=ratio)
    frames = _frames(room, two_lamps)
    fast = _pipeline(rounded, settings=settings).update(frames, poses)
    slow = _pipeline(rounded, settings=settings, backend="reference").update(frames, poses)
    np.testing.assert_allclose(fast.threshold, slow.threshold, rtol=1e-4)
    np.testing.assert_allclose(
        fast.vals["radiant_intensity"].sum(axis=0), slow.vals["radiant_intensity"].sum(axis=0), rtol=1e-4
    )
    np.testing.assert_allclose(fast.object_sh, slow.object_sh, atol=1e-4 * np.abs(slow.object_sh).max())


def test_nothing_runs_when_nothing_changed(
    room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]
) -> None:
    pipeline = _pipeline(room)
    frames = _frames(room, two_lamps)
    first = pipeline.update(frames, poses)
    again = pipeline.update(frames, poses)
    assert not _ran(again)
    assert all(stage.wall_ms == 0.0 for stage in again.stages)
    assert again.revision == first.revision
    assert again.vals is first.vals
    assert pipeline.update(frames, poses) is again


def test_equal_content_under_a_new_time_runs_nothing(
    room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]
) -> None:
    pipeline = _pipeline(room)
    frames = _frames(room, two_lamps)
    first = pipeline.update(frames, poses)
    later = [replace(frame, timestamp_ns=frame.timestamp_ns + 50, sequence=2) for frame in frames if frame]
    second = pipeline.update(later, poses)
    assert not _ran(second)
    assert second.revision == first.revision
    assert second.timestamp_ns == first.timestamp_ns + 50


def test_a_moved_object_costs_its_own_probe_only(
    room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]
) -> None:
    probes = CountingProbes(room)
    pipeline = _pipeline(room, probe_rays=probes)
    frames = _frames(room, two_lamps)
    first = pipeline.update(frames, poses)
    assert probes.calls == 2
    world_from_object = poses[1].world_from_object.copy()
    world_from_object[0, 3] += 1.0
    moved = [poses[0], replace(poses[1], revision=2, world_from_object=world_from_object)]
    second = pipeline.update(frames, moved)
    assert _ran(second) == {"probe", "sh"}
    assert probes.calls == 3
    assert second.revision == first.revision + 1
    np.testing.assert_array_equal(second.object_sh[0], first.object_sh[0])
    assert not np.array_equal(second.object_sh[1], first.object_sh[1])
    fresh = _pipeline(room).update(frames, moved)
    np.testing.assert_array_equal(second.object_sh, fresh.object_sh)


def test_new_light_does_not_trace_probes(
    room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]
) -> None:
    pipeline = _pipeline(room)
    pipeline.update(_frames(room, two_lamps), poses)
    dimmed = lamp_field(room, ((3, (0.3, 0.4), (0.08, 0.12), (20.0, 19.0, 15.0)),))
    assert _ran(pipeline.update(_frames(room, dimmed, 2), poses)) == set(STAGES) - {"probe"}


def test_new_pictures_of_the_same_light_change_nothing(
    room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]
) -> None:
    pipeline = _pipeline(room)
    first = pipeline.update(_frames(room, two_lamps), poses)
    second = pipeline.update(_frames(room, two_lamps, 2), poses)
    assert "gather" in _ran(second)
    assert second.revision == first.revision
    np.testing.assert_array_equal(second.vals, first.vals)
    np.testing.assert_array_equal(second.object_sh, first.object_sh)


def test_sensor_noise_moves_lights_less_than_five_millimetres(
    two_lamps: RadianceField, poses: list[ObjectPose]
) -> None:
    room = make_box_room(atlas_size=256, camera_size=256)
    pipeline = _pipeline(room)
    first = pipeline.update(_frames(room, two_lamps), poses)
    for revision in range(2, 8):
        update = pipeline.update(_frames(room, two_lamps, revision, noise=0.01), poses)
        np.testing.assert_array_equal(update.vals["generation"], first.vals["generation"])
        shift = np.linalg.norm(update.vals["position"] - first.vals["position"], axis=1)
        assert shift.max() < 0.005
        np.testing.assert_allclose(
            update.vals["radiant_intensity"], first.vals["radiant_intensity"], rtol=0.05
        )


def test_a_missing_camera_keeps_its_last_picture(
    room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]
) -> None:
    pipeline = _pipeline(room)
    frames = _frames(room, two_lamps)
    pipeline.update(frames, poses)
    brighter = lamp_field(room, (), ambient=2.0)
    mixed: Sequence[CameraFrame | None] = [None, *_frames(room, brighter, 2)[1:]]
    update = pipeline.update(mixed, poses)
    explicit = _pipeline(room).update([frames[0], *mixed[1:]], poses)
    np.testing.assert_array_equal(update.object_sh, explicit.object_sh)
    assert update.timestamp_ns == 1000
    assert update.counters["cameras_missing"] == 0.0


def test_cameras_that_never_delivered_are_left_out(
    room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]
) -> None:
    pipeline = _pipeline(room)
    nothing = pipeline.update([None] * 4, poses)
    assert not nothing.vals["radiant_intensity"].any()
    assert not nothing.object_sh.any()
    assert nothing.timestamp_ns == 0
    some = pipeline.update([*_frames(room, two_lamps)[:2], None, None], poses)
    assert some.counters["cameras_missing"] == 2.0
    assert some.vals["radiant_intensity"].any()


def test_objects_come_and_go(room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]) -> None:
    pipeline = _pipeline(room)
    frames = _frames(room, two_lamps)
    both = pipeline.update(frames, poses)
    one = pipeline.update(frames, poses[:1])
    np.testing.assert_array_equal(one.object_sh, both.object_sh[:1])
    assert one.revision == both.revision + 1
    again = pipeline.update(frames, poses)
    np.testing.assert_array_equal(again.object_sh, both.object_sh)
    assert pipeline.update(frames, []).object_sh.shape == (0, 9, 3)


def test_times_come_from_the_clocks_passed_in(
    room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]
) -> None:
    update = _pipeline(room, wall_clock=Ticks(), cpu_clock=Ticks()).update(_frames(room, two_lamps), poses)
    assert {stage.wall_ms for stage in update.stages} == {1000.0}
    assert {stage.cpu_ms for stage in update.stages} == {1000.0}


def test_skipped_stages_tell_what_they_saved(
    room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]
) -> None:
    """Measured by the whole runs of a stage after its first, in which kernels are compiled."""
    pipeline = _pipeline(room, wall_clock=Ticks(), cpu_clock=Ticks())
    first = pipeline.update(_frames(room, two_lamps), poses)
    assert {(stage.part, stage.saved_ms) for stage in first.stages} == {(1.0, 0.0)}
    again = pipeline.update(_frames(room, two_lamps), poses)
    assert {(stage.part, stage.saved_ms, stage.error_bound) for stage in again.stages} == {(0.0, 0.0, 0.0)}
    frames = _frames(room, two_lamps, revision=2, noise=0.1)
    moved = [replace(pose, revision=2) for pose in poses]
    assert _ran(pipeline.update(frames, moved)) == set(STAGES)
    again = pipeline.update(frames, moved)
    assert {(stage.part, stage.saved_ms, stage.error_bound) for stage in again.stages} == {(0.0, 1000.0, 0.0)}


def test_a_failed_update_is_made_up_for(
    room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]
) -> None:
    pipeline = _pipeline(room)
    frames = _frames(room, two_lamps)
    broken = [replace(frame, pixels=frame.pixels[:-1]) for frame in frames if frame]
    with pytest.raises(ConfigError, match="camera 0"):
        pipeline.update(broken, poses)
    update = pipeline.update(frames, poses)
    expected = _pipeline(room).update(frames, poses)
    np.testing.assert_array_equal(update.vals, expected.vals)
    np.testing.assert_array_equal(update.object_sh, expected.object_sh)


def test_wrong_pictures_are_refused(room: BoxRoom, two_lamps: RadianceField, poses: list[ObjectPose]) -> None:
    frames = _frames(room, two_lamps)
    with pytest.raises(ConfigError, match="per camera"):
        _pipeline(room).update(frames[:2], poses)
    with pytest.raises(ConfigError, match="camera order"):
        _pipeline(room).update(frames[::-1], poses)


@pytest.mark.parametrize(
    "change",
    [
        {"num_vals": 0},
        {"num_vals": 65},
        {"split_ratio": 0.0},
        {"split_ratio": 1.5},
        {"num_samples": 4},
        {"kmeans_iterations": 0},
    ],
)
def test_wrong_settings_are_refused(room: BoxRoom, change: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(change))):
        _pipeline(room, settings=replace(LightSettings(), **change))


def test_a_table_of_another_atlas_is_refused(room: BoxRoom) -> None:
    texels = replace(room.texels, area=room.texels.area[:-1])
    with pytest.raises(ConfigError, match="rebuild"):
        LightPipeline(room.mesh(), texels, room.table, LightSettings(), probe_rays=room, backend="cpu")


def test_auto_falls_back_to_the_processor(room: BoxRoom, monkeypatch: pytest.MonkeyPatch) -> None:
    def unavailable(name: str) -> object:
        raise GraphicsError("no context")

    monkeypatch.setattr("nearfield_server.pipeline.runner.importlib.import_module", unavailable)
    assert _pipeline(room, backend="auto").backend_name == "cpu"
    with pytest.raises(GraphicsError, match="no context"):
        _pipeline(room, backend="gl")


def test_unseen_texels_repeat_their_source_or_stay_black(room: BoxRoom, two_lamps: RadianceField) -> None:
    unseen = np.array([7, 8, 9], dtype=np.int32)
    hidden = np.zeros(room.texels.area.size, dtype=bool)
    hidden[unseen] = True
    fill = UnseenFill(texel=unseen, source=np.array([100, -1, 200], dtype=np.int32))
    pipeline = LightPipeline(
        room.mesh(),
        room.texels,
        hide_texels(room.table, hidden),
        LightSettings(),
        probe_rays=room,
        backend="cpu",
        unseen_fill=fill,
    )
    update = pipeline.update(_frames(room, two_lamps), [])
    radiance = pipeline.texel_radiance
    np.testing.assert_array_equal(radiance[7], radiance[100])
    np.testing.assert_array_equal(radiance[9], radiance[200])
    assert radiance[100].all()
    assert not radiance[8].any()
    assert update.counters["texels_unseen"] == 1.0
