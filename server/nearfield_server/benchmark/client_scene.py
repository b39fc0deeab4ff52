"""What the client benchmark draws: the room that comes with the package, lit by light packets of the real pipeline."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from nearfield_server.evaluation.evaluate import place_objects
from nearfield_server.evaluation.light_run import camera_frames
from nearfield_server.evaluation.view_truth import bundle_exposure
from nearfield_server.gateway.scene_builder import ServedScene, build_scene
from nearfield_server.geometry.cache import load_or_build
from nearfield_server.geometry.probes import ProbeRays
from nearfield_server.illumination.packet import PacketWriter
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.records import LightSettings, ObjectPose
from nearfield_server.scene.bundle import load_bundle
from nearfield_server.scene.room_config import room_from_bundle

LAB: Final = Path(__file__).resolve().parents[1] / "rooms" / "lab"
"""The room that comes with the package."""
_PRESET: Final = "medium"


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientScene:
    """Served files, one light packet per number of slots, and the exposure of the pictures."""

    served: ServedScene
    packets: dict[int, bytes]
    exposure: float


def client_scene(folder: Path, slots: Sequence[int], progress: Callable[[str], None]) -> ClientScene:
    """A room with its virtual objects, at nominal light.

    Args:
        folder: an evaluation bundle.
        slots: numbers of VAL slots to make packets for.
        progress: called with a line of text before each step.

    Raises:
        AssetError: the bundle is broken or missing.
    """
    bundle = load_bundle(folder)
    room = room_from_bundle(bundle)
    progress("geometry of the room")
    mesh, texels, table, fill, hidden = load_or_build(room)
    served = build_scene(room, mesh, len(texels.texel_index), preset=_PRESET, progress=progress)
    frames, _ = camera_frames(bundle, np.ones(len(room.lights)))
    poses = [
        ObjectPose(
            object_index=index,
            revision=0,
            world_from_object=item.world_from_object,
            centre_object=item.model.centre,
            radius=item.model.radius,
        )
        for index, item in enumerate(place_objects(bundle, _PRESET))
    ]
    packets = {}
    for number in slots:
        progress(f"light with {number} slots")
        pipeline = LightPipeline(
            mesh,
            texels,
            table,
            LightSettings(num_vals=number),
            probe_rays=ProbeRays(mesh, texels),
            unseen_fill=fill,
            hidden_light=hidden,
        )
        packets[number] = PacketWriter.for_room(mesh, 0).write(pipeline.update(frames, poses), poses)
    return ClientScene(served=served, packets=packets, exposure=bundle_exposure(bundle))
