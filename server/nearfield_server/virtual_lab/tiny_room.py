"""The tiny fixture room: a small box with two lights and a sphere, rendered in seconds."""

from __future__ import annotations

import numpy as np
import trimesh

from nearfield_server.virtual_lab.meshes import make_object
from nearfield_server.virtual_lab.model import Light, Scene, Sequence, fisheye, tablet
from nearfield_server.virtual_lab.shapes import box, box_face, downward_lamp, pose, quad, with_cell_size

SIZE = (2.0, 1.6, 2.0)
PEDESTAL_TOP = 0.5


def build_tiny_room() -> Scene:
    """Two lights, two 128^2 fish-eyes, one 96x54 view, an icosphere on a pedestal."""
    lo = (0.0, 0.0, 0.0)
    walls = {"-y": "floor", "+y": "ceiling", "-x": "red", "+x": "white", "-z": "white", "+z": "blue"}
    quads = [box_face(lo, SIZE, face, material, inward=True) for face, material in walls.items()]
    quads += downward_lamp(
        (1.0, 1.52, 1.0),
        (0.44, 0.08, 0.44),
        rim=0.02,
        recess=0.01,
        material="grey",
        inside="grey",
        emitter="emit_ceiling",
        light=0,
        skip="+y",
    )
    quads += box((1.97, 0.5, 1.3), (2.0, 1.0, 1.8), "grey", skip="-x +x")
    quads.append(quad((1.97, 0.5, 1.3), (0.0, 0.0, 0.5), (0.0, 0.5, 0.0), "emit_side", light=1))
    fine = box((0.7, 0.0, 0.7), (1.3, PEDESTAL_TOP, 1.3), "wood") + box(
        (1.15, PEDESTAL_TOP, 1.14), (1.25, 0.72, 1.24), "grey"
    )
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=0.17)
    ball = make_object(
        sphere,
        name="ball",
        albedo=(0.7, 0.6, 0.3),
        scale=1.0,
        world_from_object=pose((0.95, PEDESTAL_TOP, 0.95), yaw=0.3),
        source="icosphere, 2 subdivisions (generated)",
    )
    ramp = np.linspace(0.0, 1.0, 12)
    return Scene(
        name="tiny",
        size=SIZE,
        materials={
            "floor": (0.5, 0.48, 0.45),
            "ceiling": (0.8, 0.8, 0.8),
            "red": (0.65, 0.08, 0.06),
            "white": (0.72, 0.72, 0.72),
            "blue": (0.1, 0.16, 0.6),
            "wood": (0.5, 0.36, 0.22),
            "grey": (0.4, 0.4, 0.42),
            "emit_ceiling": (0.0, 0.0, 0.0),
            "emit_side": (0.0, 0.0, 0.0),
        },
        quads=tuple(with_cell_size(quads, 0.05) + with_cell_size(fine, 0.02)),
        lights=(
            Light(name="ceiling", kind="ceiling panel, 0.40 x 0.40 m", radiance=(12.0, 11.0, 9.0)),
            Light(name="side", kind="wall panel, 0.50 x 0.50 m", radiance=(3.0, 4.0, 6.0)),
        ),
        objects=(ball,),
        cameras=(
            fisheye(128, (0.1, 1.4, 0.1), (1.0, 0.5, 1.0), (0.0, 0.0, 0.0, 0.0)),
            fisheye(128, (1.9, 1.4, 1.85), (1.0, 0.5, 0.9), (0.03, -0.012, 0.004, -0.0006)),
        ),
        views=(tablet(96, 54, (0.55, 1.05, 1.85), (0.98, 0.62, 0.98), float(np.radians(50))),),
        sequences=(Sequence(name="side_on", weights=np.stack([np.ones(12), ramp], axis=1)),),
        atlas_size=256,
    )
