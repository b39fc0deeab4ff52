"""Rooms drawn at random: the check that nothing is tuned to one room.

Size, colours, furniture, one to ten lights of different kinds, one or two virtual objects, cameras and views all follow from a seed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from nearfield_server.virtual_lab.meshes import make_object
from nearfield_server.virtual_lab.model import (
    Light,
    Quad,
    Scene,
    Sensor,
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
    with_cell_size,
)

MAX_LIGHTS = 10
FISHEYE_SIZE, VIEW_SIZE = 512, (480, 270)
SEQUENCE_FRAMES = 12
_CEILING_GRID = 3
_FURNITURE = ("wood", "metal", "bright", "colour")

_MakeLamp = Callable[[int], tuple[list[Quad], str, float]]
"""Light number to quads, kind for people, and area of the emitter."""


class _Draw:
    """One room being drawn; every random number comes from one generator, in a fixed order."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.size: Vector = (self._between(2.6, 7.0), self._between(2.3, 3.2), self._between(2.6, 6.0))
        self.table_top = self._between(0.45, 0.8)
        self.table_half = (self._between(0.45, 0.7), self._between(0.35, 0.5))
        x, _, z = self.size
        self.table_centre = (x * self._between(0.42, 0.58), z * self._between(0.42, 0.58))

    def _between(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def materials(self) -> dict[str, Vector]:
        """Walls from dark to white, some strongly coloured."""
        names = ("floor", "ceiling", "wall_0", "wall_1", "wall_2", "wall_3", *_FURNITURE)
        result: dict[str, Vector] = {"emitter": (0.0, 0.0, 0.0), "lamp_inside": (0.1, 0.1, 0.1)}
        for name in names:
            grey = self._between(0.6, 0.85) if name == "ceiling" else self._between(0.2, 0.8)
            tint = self.rng.uniform(0.15, 1.0, 3) if self.rng.random() < 0.4 else np.ones(3)
            red, green, blue = (grey * tint / tint.max()).tolist()
            result[name] = (red, green, blue)
        return result

    def shell_and_furniture(self) -> list[Quad]:
        """Walls, the table with something real on it, and boxes along the walls."""
        lo, (x, y, z) = (0.0, 0.0, 0.0), self.size
        walls = {
            "-x": "wall_0",
            "+x": "wall_1",
            "-z": "wall_2",
            "+z": "wall_3",
            "-y": "floor",
            "+y": "ceiling",
        }
        quads = [box_face(lo, self.size, face, material, inward=True) for face, material in walls.items()]
        for corner in range(int(self.rng.integers(1, 5))):
            width, height, depth = (
                self._between(0.3, 0.7),
                self._between(0.3, 0.6 * y),
                self._between(0.3, 0.5),
            )
            x0 = 0.0 if corner % 2 == 0 else x - width
            z0 = 0.0 if corner < 2 else z - depth
            material = _FURNITURE[int(self.rng.integers(len(_FURNITURE)))]
            skip = f"-y {'-x' if corner % 2 == 0 else '+x'} {'-z' if corner < 2 else '+z'}"
            quads += box((x0, 0.0, z0), (x0 + width, height, z0 + depth), material, skip=skip)
        return quads

    def table(self) -> list[Quad]:
        """A plinth, and a box on it that casts a shadow and colour."""
        (cx, cz), (hx, hz), top = self.table_centre, self.table_half, self.table_top
        quads = box((cx - hx, 0.0, cz - hz), (cx + hx, top, cz + hz), "wood")
        tall, side = self._between(0.1, 0.35), float(self.rng.choice((-1.0, 1.0)))
        x0 = cx + side * (hx - 0.08) - 0.03
        quads += box((x0, top, cz - 0.6 * hz), (x0 + 0.06, top + tall, cz + 0.6 * hz), "colour")
        return quads

    def objects(self) -> tuple[VirtualObject, ...]:
        """A bumpy ball, and with even odds a ring lying beside it."""
        (cx, cz), top = self.table_centre, self.table_top
        ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
        direction = np.asarray(ball.vertices)
        wave = self.rng.normal(0.0, 3.0, (3, 3))
        ball.vertices = direction * (1.0 + 0.12 * np.sin(direction @ wave).sum(axis=1, keepdims=True))
        two = bool(self.rng.random() < 0.5)
        shift = 0.17 if two else 0.0
        result = [self._object(ball, "ball", self._between(0.1, 0.13), (cx - shift, top, cz))]
        if two:
            ring = trimesh.creation.torus(1.0, 0.4, major_sections=40, minor_sections=20)
            # The ring lies in the plane across +y.
            ring.vertices = np.asarray(ring.vertices)[:, [0, 2, 1]]
            ring.invert()
            result.append(self._object(ring, "ring", self._between(0.07, 0.09), (cx + shift, top, cz)))
        return tuple(result)

    def _object(self, mesh: trimesh.Trimesh, name: str, scale: float, position: Vector) -> VirtualObject:
        red, green, blue = self.rng.uniform(0.1, 0.75, 3).tolist()
        return make_object(
            mesh,
            name=name,
            albedo=(red, green, blue),
            scale=scale,
            world_from_object=pose(position, yaw=self._between(0.0, 6.0)),
            source="generated",
        )

    def lights(self) -> tuple[list[Quad], tuple[Light, ...]]:
        """One to ten lights; each place is used once."""
        places: list[_MakeLamp] = [self._window(wall) for wall in range(2)]
        places += [self._ceiling_lamp(cell) for cell in range(_CEILING_GRID**2)]
        places += [self._strip, self._desk_lamp]
        chosen = self.rng.permutation(len(places))[: int(self.rng.integers(1, MAX_LIGHTS + 1))]
        quads: list[Quad] = []
        lights: list[Light] = []
        for number, place in enumerate(chosen.tolist()):
            lamp, kind, area = places[place](number)
            quads += lamp
            # Radiant exitance times area within a decade, whatever the size: small lamps are very bright ones.
            power = 10.0 ** self._between(0.0, 1.0)
            tint = (
                self.rng.uniform(0.1, 1.0, 3) if self.rng.random() < 0.3 else self.rng.uniform(0.75, 1.0, 3)
            )
            red, green, blue = (power / (np.pi * area) * tint / tint.max()).tolist()
            lights.append(Light(name=f"light_{number}", kind=kind, radiance=(red, green, blue)))
        return quads, tuple(lights)

    def _window(self, wall: int) -> _MakeLamp:
        def make(number: int) -> tuple[list[Quad], str, float]:
            x, y, z = self.size
            width, height = self._between(0.8, 0.6 * x), self._between(0.6, 0.5 * y)
            x0, y0 = 0.5 * (x - width), 0.4 * y
            lo, hi = ((x0, y0, 0.0), (x0 + width, y0 + height, 0.02))
            if wall:
                lo, hi = ((x0, y0, z - 0.02), (x0 + width, y0 + height, z))
            inner, outer = ("+z", "-z") if wall == 0 else ("-z", "+z")
            pane = replace(box_face(lo, hi, inner, "emitter"), light=number)
            frame = box(lo, hi, "bright", skip=f"{inner} {outer}")
            return [*frame, pane], f"window, {width:.2f} x {height:.2f} m", width * height

        return make

    def _ceiling_lamp(self, cell: int) -> _MakeLamp:
        def make(number: int) -> tuple[list[Quad], str, float]:
            x, y, z = self.size
            row, column = divmod(cell, _CEILING_GRID)
            side = float(np.exp(self._between(np.log(0.04), np.log(0.5))))
            centre = ((column + 0.5) * x / _CEILING_GRID, y - 0.06, (row + 0.5) * z / _CEILING_GRID)
            recess = self._between(0.005, 0.04)
            lamp = downward_lamp(
                centre,
                (side + 0.04, 0.06, side + 0.04),
                rim=0.02,
                recess=recess,
                material="metal",
                inside="lamp_inside",
                emitter="emitter",
                light=number,
                skip="+y",
            )
            return lamp, f"ceiling lamp, {side:.2f} m", side * side

        return make

    def _strip(self, number: int) -> tuple[list[Quad], str, float]:
        """Under a shelf on the wall x = 0, seen by few cameras."""
        _, y, z = self.size
        length, height = self._between(0.5, 0.4 * z), 0.55 * y
        z0 = 0.5 * (z - length)
        shelf = box((0.0, height, z0 - 0.05), (0.25, height + 0.03, z0 + length + 0.05), "wood", skip="-x -y")
        bottom = [
            quad((0.0, height, z0 - 0.05), (0.19, 0.0, 0.0), (0.0, 0.0, length + 0.1), "wood"),
            quad((0.22, height, z0 - 0.05), (0.03, 0.0, 0.0), (0.0, 0.0, length + 0.1), "wood"),
            quad((0.19, height, z0 - 0.05), (0.03, 0.0, 0.0), (0.0, 0.0, 0.05), "wood"),
            quad((0.19, height, z0 + length), (0.03, 0.0, 0.0), (0.0, 0.0, 0.05), "wood"),
            quad((0.19, height, z0), (0.03, 0.0, 0.0), (0.0, 0.0, length), "emitter", light=number),
        ]
        return shelf + bottom, f"strip under a shelf, {length:.2f} x 0.03 m", 0.03 * length

    def _desk_lamp(self, number: int) -> tuple[list[Quad], str, float]:
        """A shade over the table that hides its emitter from most of the room."""
        (cx, cz), (_, hz), top = self.table_centre, self.table_half, self.table_top
        side, height = self._between(0.05, 0.12), top + self._between(0.4, 0.6)
        lamp = downward_lamp(
            (0.0, 0.0, 0.0),
            (side + 0.05, 0.1, side + 0.05),
            rim=0.02,
            recess=0.03,
            material="metal",
            inside="lamp_inside",
            emitter="emitter",
            light=number,
        )
        return transformed(lamp, pose((cx, height, cz - 0.5 * hz))), f"desk lamp, {side:.2f} m", side * side

    def cameras(self) -> tuple[Sensor, ...]:
        """Two to four fish-eyes in upper corners, looking at the table."""
        x, y, z = self.size
        target = (self.table_centre[0], self.table_top, self.table_centre[1])
        corners = ((0.0, 0.0), (x, z), (x, 0.0), (0.0, z))[: int(self.rng.integers(2, 5))]
        eyes: list[Vector] = []
        for corner_x, corner_z in corners:
            inset = self._between(0.1, 0.3)
            eye_x, eye_z = abs(corner_x - inset), abs(corner_z - inset)
            eyes.append((eye_x, y - self._between(0.1, 0.4), eye_z))
        return tuple(fisheye(FISHEYE_SIZE, eye, target, (0.0, 0.0, 0.0, 0.0)) for eye in eyes)

    def views(self) -> tuple[Sensor, ...]:
        """Two tablets near the table, from two sides, clear of the furniture in the corners."""
        (cx, cz), top = self.table_centre, self.table_top
        turn = self._between(0.0, 2.0 * np.pi)
        sensors = []
        for angle in (turn, turn + self._between(1.2, 2.0)):
            reach = 0.3 * min(self.size[0], self.size[2])
            eye = (cx + reach * np.cos(angle), top + self._between(0.35, 0.6), cz + reach * np.sin(angle))
            sensors.append(tablet(*VIEW_SIZE, eye, (cx, top + 0.08, cz), float(np.radians(55))))
        return tuple(sensors)

    def sequence(self, num_lights: int) -> Sequence:
        """Lights at random weights: off, dimmed or full; never all off."""
        weights: NDArray[np.float64] = self.rng.choice((0.0, 0.1, 1.0), (SEQUENCE_FRAMES, num_lights))
        weights[~weights.any(axis=1), 0] = 0.1
        return Sequence(name="random", weights=weights)


def build_random_room(seed: int) -> Scene:
    """The room of a seed; equal seeds give equal rooms."""
    draw = _Draw(seed)
    materials = draw.materials()
    room, table, objects = draw.shell_and_furniture(), draw.table(), draw.objects()
    lamps, lights = draw.lights()
    return Scene(
        name=f"random_{seed}",
        size=draw.size,
        materials=materials,
        quads=tuple(with_cell_size(room + lamps, 0.06) + with_cell_size(table, 0.03)),
        lights=lights,
        objects=objects,
        cameras=draw.cameras(),
        views=draw.views(),
        sequences=(draw.sequence(len(lights)),),
        atlas_size=512,
    )
