"""Rooms to measure on: a box in closed form, or an evaluation bundle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.pipeline.hidden_light import HiddenLight
from nearfield_server.pipeline.probes import ProbeTracer
from nearfield_server.records import (
    FRAME_TILE,
    CameraFrame,
    GatherTable,
    ObjectPose,
    RoomMesh,
    TexelGeometry,
    UnseenFill,
)
from nearfield_server.reference.box_room import lamp_field, make_box_room

_NUM_OBJECTS: Final = 3
_NOISE: Final = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """What is measured: a room, its probes and pictures of all its cameras.

    Attributes:
        num_lamps: lamps that can be switched. without_lamp: pictures with one of them off, the others at nominal weight.
    """

    name: str
    mesh: RoomMesh
    texels: TexelGeometry
    table: GatherTable
    probes: ProbeTracer
    pictures: tuple[NDArray[np.float16], ...]
    objects: tuple[ObjectPose, ...]
    unseen_fill: UnseenFill | None = None
    hidden_light: HiddenLight | None = None
    num_lamps: int = 0
    without_lamp: Callable[[int], tuple[NDArray[np.float16], ...]] | None = None


def noisy_frames(scenario: Scenario, seed: int) -> tuple[CameraFrame, ...]:
    """The pictures with one per cent of noise, so that every stage has real work; every tile differs from that of another seed."""
    rng = np.random.default_rng(seed)
    frames = []
    for index, picture in enumerate(scenario.pictures):
        pixels = picture.copy()
        gain = rng.normal(1.0, _NOISE, (*pixels.shape[:2], 1)).astype(np.float32)
        pixels[..., :3] = np.clip(pixels[..., :3].astype(np.float32) * gain, 0.0, 65504.0)
        tiles = tuple(-(-edge // FRAME_TILE) for edge in pixels.shape[:2])
        frames.append(
            CameraFrame(
                camera_index=index,
                sequence=0,
                content_revision=0,
                timestamp_ns=0,
                pixels=pixels,
                tile_revisions=np.full(tiles, 2 * seed, dtype=np.int64),
            )
        )
    return tuple(frames)


def with_changed_tiles(
    frames: tuple[CameraFrame, ...], other: tuple[CameraFrame, ...], share: float, seed: int
) -> tuple[tuple[CameraFrame, ...], float]:
    """Pictures in which a few tiles, anywhere, show other pictures of the same cameras.

    Args:
        frames: with tile revisions.
        other: where the changed tiles come from.
        share: of the tiles of every camera; at least one changes.
        seed: of the choice of tiles.

    Returns:
        The pictures, with new tile revisions where they changed, and the share of the tiles that did.
    """
    rng = np.random.default_rng(seed)
    result, changed, total = [], 0, 0
    for frame, source in zip(frames, other, strict=True):
        assert frame.tile_revisions is not None
        pixels, revisions = frame.pixels.copy(), frame.tile_revisions.copy()
        count = max(1, round(share * revisions.size))
        for tile in rng.choice(revisions.size, count, replace=False):
            row, column = divmod(int(tile), revisions.shape[1])
            area = np.s_[
                row * FRAME_TILE : (row + 1) * FRAME_TILE, column * FRAME_TILE : (column + 1) * FRAME_TILE
            ]
            pixels[area] = source.pixels[area]
            revisions[row, column] += 1
        changed, total = changed + count, total + revisions.size
        result.append(replace(frame, pixels=pixels, tile_revisions=revisions))
    return tuple(result), changed / total


def _objects(
    low: NDArray[np.float64], high: NDArray[np.float64], count: int = _NUM_OBJECTS
) -> tuple[ObjectPose, ...]:
    """Objects along the diagonal of the room's box, a third of its height above the floor."""
    objects = []
    for index in range(count):
        world_from_object = np.eye(4)
        place = 0.3 + 0.4 * index / max(count - 1, 1)
        world_from_object[:3, 3] = low + (high - low) * [place, 0.33, place]
        objects.append(
            ObjectPose(
                object_index=index,
                revision=1,
                world_from_object=world_from_object,
                centre_object=np.zeros(3),
                radius=0.15,
            )
        )
    return tuple(objects)


def box_scenario(
    size: int, *, camera_size: int | None = None, num_cameras: int = 4, num_objects: int = _NUM_OBJECTS
) -> Scenario:
    """A box room in closed form with a lamp and a window.

    Args:
        size: edge of the atlas, texels.
        camera_size: edge of every picture, pixels; None = as large as the atlas.
        num_cameras: fish-eyes in the upper corners.
        num_objects: virtual objects.
    """
    room = make_box_room(atlas_size=size, camera_size=camera_size or size, num_cameras=num_cameras)
    lamp = (3, (0.5, 0.5), (0.1, 0.1), (40.0, 38.0, 30.0))
    window = (0, (0.5, 0.6), (0.1, 0.2), (10.0, 12.0, 15.0))
    lamps = (lamp, window)

    def pictures(on: tuple[bool, ...]) -> tuple[NDArray[np.float16], ...]:
        # Half of the walls' light comes from the lamps.
        field = lamp_field(room, tuple(compress(lamps, on)), ambient=0.5 + 0.5 * sum(on) / len(on))
        return tuple(room.picture(index, field) for index in range(len(room.cameras)))

    return Scenario(
        name="box room",
        mesh=room.mesh(),
        texels=room.texels,
        table=room.table,
        probes=room,
        pictures=pictures((True, True)),
        objects=_objects(np.zeros(3), room.size, num_objects),
        num_lamps=len(lamps),
        without_lamp=lambda lamp: pictures(tuple(index != lamp for index in range(len(lamps)))),
    )


def bundle_scenario(folder: Path) -> Scenario:
    """The room of an evaluation bundle, its lamps at nominal weight.

    Raises:
        AssetError: the bundle is broken.
    """
    # Geometry and evaluation bring ray tracing and image libraries; the box room does without.
    from nearfield_server.evaluation.light_run import camera_frames
    from nearfield_server.geometry.cache import load_or_build
    from nearfield_server.geometry.probes import ProbeRays
    from nearfield_server.scene.bundle import load_bundle
    from nearfield_server.scene.room_config import room_from_bundle

    bundle = load_bundle(folder)
    room = room_from_bundle(bundle)
    mesh, texels, table, fill, hidden = load_or_build(room)
    num_lamps = len(room.lights)

    def pictures(weights: NDArray[np.float64]) -> tuple[NDArray[np.float16], ...]:
        return tuple(frame.pixels for frame in camera_frames(bundle, weights)[0])

    return Scenario(
        name=room.name,
        mesh=mesh,
        texels=texels,
        table=table,
        probes=ProbeRays(mesh, texels),
        pictures=pictures(np.ones(num_lamps)),
        objects=_objects(mesh.positions.min(axis=0), mesh.positions.max(axis=0)),
        unseen_fill=fill,
        hidden_light=hidden,
        num_lamps=num_lamps,
        without_lamp=lambda lamp: pictures(1.0 - np.eye(num_lamps)[lamp]),
    )
