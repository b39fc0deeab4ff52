"""Updates from changed tiles leave the bits of whole ones, through every stage, whatever happens to pictures and objects."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nearfield_server.pipeline.hidden_light import HiddenLight
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.records import (
    FRAME_TILE,
    CameraFrame,
    LightSettings,
    LightUpdate,
    ObjectPose,
    UnseenFill,
)
from nearfield_server.reference.box_room import BoxRoom, hide_texels, lamp_field, make_box_room

ATLAS = 72
CAMERA = 80
BROKEN = (np.nan, np.inf, -np.inf, -1.0)


class _Studio:
    """A room whose camera pictures are edited patch by patch."""

    def __init__(self, seed: int, num_cameras: int = 3) -> None:
        self.rng = np.random.default_rng(seed)
        self.room: BoxRoom = make_box_room(atlas_size=ATLAS, camera_size=CAMERA, num_cameras=num_cameras)
        lamp = (3, (0.3, 0.4), (0.1, 0.15), (40.0, 38.0, 30.0))
        dark, lit = lamp_field(self.room, ()), lamp_field(self.room, (lamp,))
        self.scenes = [[self.room.picture(k, field) for k in range(num_cameras)] for field in (dark, lit)]
        self.pixels = [picture.copy() for picture in self.scenes[1]]
        rows = -(-CAMERA // FRAME_TILE)
        self.tiles = [np.zeros((rows, rows), dtype=np.int64) for _ in range(num_cameras)]
        self.revisions = [1] * num_cameras
        self.delivers = [True] * (num_cameras - 1) + [False]
        self.poses = [_pose(k, (1.5 + k, 1.0, 2.0), 1) for k in range(2)]

    def pipeline(self, split_ratio: float | None = None) -> LightPipeline:
        texels = self.room.texels
        unseen = np.zeros(texels.area.size, dtype=bool)
        unseen[50:90] = unseen[2000:2003] = True
        fill = np.flatnonzero(unseen[:100]).astype(np.int32)
        hidden = np.array([2000, 2001, 2002], dtype=np.int32)
        return LightPipeline(
            self.room.mesh(),
            texels,
            hide_texels(self.room.table, unseen),
            LightSettings(num_vals=6, num_samples=256, kmeans_iterations=4, split_ratio=split_ratio),
            probe_rays=self.room,
            backend="cpu",
            unseen_fill=UnseenFill(texel=fill, source=fill + 300),
            hidden_light=_hidden_light(hidden),
        )

    def patch(
        self, camera: int, row: int, column: int, size: int, scene: int, gain: float, bad: float | None
    ) -> None:
        """Show another scene, or broken pixels, in a square of one picture; a gain of 1 may change nothing at all."""
        area = np.s_[row : row + size, column : column + size]
        self.pixels[camera] = self.pixels[camera].copy()
        square = self.scenes[scene][camera][area].copy()
        square[..., :3] *= np.float16(gain)
        if bad is not None:
            square[0, 0, self.rng.integers(4)] = np.float16(bad)
            square[-1, -1, 3] = 0.0
        self.pixels[camera][area] = square
        self.revisions[camera] += 1
        self.tiles[camera][
            row // FRAME_TILE : (min(row + size, CAMERA) - 1) // FRAME_TILE + 1,
            column // FRAME_TILE : (min(column + size, CAMERA) - 1) // FRAME_TILE + 1,
        ] += 1

    def frames(self, *, tell_tiles: bool) -> list[CameraFrame | None]:
        return [
            CameraFrame(
                camera_index=k,
                sequence=self.revisions[k],
                content_revision=self.revisions[k],
                timestamp_ns=self.revisions[k],
                pixels=self.pixels[k],
                tile_revisions=self.tiles[k] if tell_tiles else None,
            )
            if self.delivers[k]
            else None
            for k in range(len(self.pixels))
        ]

    def random_edit(self) -> None:
        rng = self.rng
        camera = int(rng.integers(len(self.pixels)))
        row, column = (int(value) for value in rng.integers(0, CAMERA - 1, 2))
        size = int(rng.choice([1, 3, 12, 80], p=[0.3, 0.3, 0.3, 0.1]))
        bad = float(rng.choice(BROKEN)) if rng.random() < 0.1 else None
        self.patch(
            camera, row, column, size, int(rng.integers(2)), float(rng.choice([1.0, 1.0, 0.5, 1.02])), bad
        )
        if rng.random() < 0.05:
            self.delivers[-1] = True
        if rng.random() < 0.1:
            k = int(rng.integers(2))
            self.poses[k] = _pose(k, tuple(rng.uniform(0.5, 2.5, 3)), self.poses[k].revision + 1)


def _pose(index: int, place: tuple[float, ...], revision: int) -> ObjectPose:
    world_from_object = np.eye(4)
    world_from_object[:3, 3] = place
    return ObjectPose(
        object_index=index,
        revision=revision,
        world_from_object=world_from_object,
        centre_object=np.zeros(3),
        radius=0.2,
    )


def _hidden_light(texels: np.ndarray) -> HiddenLight:
    """One hidden surface, receivers of which any bright floor makes a lamp."""
    receivers = np.arange(1200, 1207, dtype=np.int32)[:, None]
    return HiddenLight(
        texels=texels,
        group=np.zeros(texels.size, dtype=np.int32),
        receiver=receivers,
        group_rows=np.array([0, 7]),
        inverse_albedo=np.full((7, 3), 2.0 * np.pi),
        form_factor=np.full((7, 1), 0.2),
        ray_start=np.arange(8, dtype=np.int64),
        ray_texel=np.full(7, 60, dtype=np.int32),
        ray_weight=np.full(7, 1.0, dtype=np.float32),
    )


def _assert_same(found: LightUpdate, expected: LightUpdate) -> None:
    assert found.revision == expected.revision
    np.testing.assert_array_equal(found.threshold, expected.threshold)
    assert found.vals.tobytes() == expected.vals.tobytes()
    assert found.object_sh.tobytes() == expected.object_sh.tobytes()
    # Everything behind the gather does the same work for the same reasons.
    for mine, other in zip(found.stages[1:], expected.stages[1:], strict=True):
        assert (mine.name, mine.ran, mine.reason, mine.part) == (
            other.name,
            other.ran,
            other.reason,
            other.part,
        )
        assert mine.error_bound == 0.0


@pytest.mark.parametrize("split_ratio", [None, 0.6])
def test_a_thousand_random_edits(split_ratio: float | None) -> None:
    studio = _Studio(7)
    partial, whole = studio.pipeline(split_ratio), studio.pipeline(split_ratio)
    parts, skipped = [], 0
    for step in range(1000):
        # Now and then a camera does not tell its tiles.
        found = partial.update(studio.frames(tell_tiles=step % 29 != 7), studio.poses)
        expected = whole.update(studio.frames(tell_tiles=False), studio.poses)
        _assert_same(found, expected)
        assert partial.texel_radiance.tobytes() == whole.texel_radiance.tobytes()
        parts.append(found.stages[0].part)
        skipped += not found.stages[2].ran
        for _ in range(int(studio.rng.integers(0, 3))):
            studio.random_edit()
    assert np.isfinite(partial.texel_radiance).all()
    assert sum(0.0 < part < 0.6 for part in parts) > 300
    assert 100 < skipped < 990


def _edits() -> st.SearchStrategy[list[tuple[int, int, int, int, int, float, float | None]]]:
    position = st.integers(0, CAMERA - 1)
    edit = st.tuples(
        st.integers(0, 1),
        position,
        position,
        st.integers(1, CAMERA),
        st.integers(0, 1),
        st.sampled_from([0.0, 1.0, 3.0]),
        st.sampled_from([None, *BROKEN]),
    )
    return st.lists(edit, min_size=1, max_size=6)


@pytest.fixture(scope="module")
def studios() -> tuple[_Studio, LightPipeline, LightPipeline]:
    studio = _Studio(3, num_cameras=2)
    studio.delivers = [True, True]
    return studio, studio.pipeline(), studio.pipeline()


@settings(max_examples=60, deadline=None)
@given(steps=_edits())
def test_any_edits(studios: tuple[_Studio, LightPipeline, LightPipeline], steps: list) -> None:
    studio, partial, whole = studios
    for step in steps:
        studio.patch(*step)
        found = partial.update(studio.frames(tell_tiles=True), studio.poses)
        _assert_same(found, whole.update(studio.frames(tell_tiles=False), studio.poses))
    assert partial.texel_radiance.tobytes() == whole.texel_radiance.tobytes()


def test_untouched_light_runs_nothing_behind_the_gather() -> None:
    studio = _Studio(5)
    pipeline = studio.pipeline()
    pipeline.update(studio.frames(tell_tiles=True), studio.poses)
    studio.patch(0, 40, 40, 3, 1, 1.0, None)
    update = pipeline.update(studio.frames(tell_tiles=True), studio.poses)
    assert [stage.name for stage in update.stages if stage.ran] == ["gather"]
    assert 0.0 < update.stages[0].part < 0.6
    assert {stage.reason for stage in update.stages[1:5]} == {"same radiance"}


def test_only_indirect_light_changed_leaves_the_lights_alone() -> None:
    studio = _Studio(6)
    pipeline = studio.pipeline()
    first = pipeline.update(studio.frames(tell_tiles=True), studio.poses)
    floor = np.flatnonzero(studio.room.face_of(studio.room.texels.position.astype(np.float64)) == 2)
    table = studio.room.table
    pixel = table.pixel[table.pair_start[floor[floor.size // 2]]]
    row, column = divmod(int(pixel), CAMERA)
    studio.patch(int(table.camera[table.pair_start[floor[floor.size // 2]]]), row, column, 2, 1, 1.02, None)
    update = pipeline.update(studio.frames(tell_tiles=True), studio.poses)
    ran = {stage.name for stage in update.stages if stage.ran}
    assert {"gather", "split"} <= ran <= {"gather", "split", "sh"}
    assert update.vals is first.vals
    assert {stage.reason for stage in update.stages[2:5]} == {"same direct light"}


def test_a_failed_update_is_made_up_for_in_full(monkeypatch: pytest.MonkeyPatch) -> None:
    studio = _Studio(8)
    pipeline, fresh = studio.pipeline(), studio.pipeline()
    pipeline.update(studio.frames(tell_tiles=True), studio.poses)
    fresh.update(studio.frames(tell_tiles=False), studio.poses)
    studio.patch(0, 10, 10, 60, 0, 1.0, None)

    def fail(*_: object) -> None:
        raise RuntimeError("out of memory")

    with monkeypatch.context() as patched:
        patched.setattr("nearfield_server.pipeline.backend.sample_direct_texels", fail)
        with pytest.raises(RuntimeError, match="memory"):
            pipeline.update(studio.frames(tell_tiles=True), studio.poses)
    found = pipeline.update(studio.frames(tell_tiles=True), studio.poses)
    assert [stage.part for stage in found.stages[:5]] == [1.0] * 5
    expected = fresh.update(studio.frames(tell_tiles=False), studio.poses)
    assert found.vals.tobytes() == expected.vals.tobytes()
    assert found.object_sh.tobytes() == expected.object_sh.tobytes()


def test_revisions_of_another_tiling_are_not_trusted() -> None:
    studio = _Studio(9)
    pipeline = studio.pipeline()
    frames = studio.frames(tell_tiles=True)
    pipeline.update(frames, studio.poses)
    studio.patch(0, 10, 10, 60, 0, 1.0, None)
    odd = [
        None if frame is None else replace(frame, tile_revisions=np.zeros((1, 1), dtype=np.int64))
        for frame in studio.frames(tell_tiles=True)
    ]
    assert pipeline.update(odd, studio.poses).stages[0].part == 1.0
