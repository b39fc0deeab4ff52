"""Builders of quads: boxes, rooms, walls with a window hole, lamp housings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nearfield_server.virtual_lab.model import Quad, Vector

# Axis and sign of each face name.
FACES = {"-x": (0, -1), "+x": (0, 1), "-y": (1, -1), "+y": (1, 1), "-z": (2, -1), "+z": (2, 1)}


def quad(
    p0: Sequence[float], e1: Sequence[float], e2: Sequence[float], material: str, *, light: int = -1
) -> Quad:
    """A quad from any sequences; front normal e1 x e2."""
    p0_array, e1_array, e2_array = (np.asarray(v, dtype=np.float64) for v in (p0, e1, e2))
    return Quad(p0=p0_array, e1=e1_array, e2=e2_array, material=material, light=light)


def box_face(
    lo: Sequence[float], hi: Sequence[float], face: str, material: str, *, inward: bool = False
) -> Quad:
    """One face of the axis-aligned box [lo, hi]; the front looks out of the box, or into it when `inward`."""
    axis, sign = FACES[face]
    low, high = np.asarray(lo, dtype=np.float64), np.asarray(hi, dtype=np.float64)
    first, second = np.zeros(3), np.zeros(3)
    first[(axis + 1) % 3] = (high - low)[(axis + 1) % 3]
    second[(axis + 2) % 3] = (high - low)[(axis + 2) % 3]
    p0 = low.copy()
    if sign > 0:
        p0[axis] = high[axis]
    if (sign > 0) == inward:
        first, second = second, first
    return Quad(p0=p0, e1=first, e2=second, material=material)


def box(lo: Sequence[float], hi: Sequence[float], material: str, *, skip: str = "-y") -> list[Quad]:
    """A closed box; faces named in `skip` (space separated) touch another surface and are left out."""
    return [box_face(lo, hi, face, material) for face in FACES if face not in skip.split()]


def wall_with_hole(wall: Quad, u_range: tuple[float, float], v_range: tuple[float, float]) -> list[Quad]:
    """Four quads around the hole `u_range` x `v_range` (metres along e1 and e2) of a wall."""
    u_unit, v_unit = wall.e1 / np.linalg.norm(wall.e1), wall.e2 / np.linalg.norm(wall.e2)
    u_end, v_end = float(np.linalg.norm(wall.e1)), float(np.linalg.norm(wall.e2))
    (u0, u1), (v0, v1) = u_range, v_range
    parts = [(0.0, u0, 0.0, v_end), (u1, u_end, 0.0, v_end), (u0, u1, 0.0, v0), (u0, u1, v1, v_end)]
    return [
        replace(wall, p0=wall.p0 + a * u_unit + c * v_unit, e1=(b - a) * u_unit, e2=(d - c) * v_unit)
        for a, b, c, d in parts
    ]


def downward_lamp(
    centre: Vector,
    size: Vector,
    *,
    rim: float,
    recess: float,
    material: str,
    inside: str,
    emitter: str,
    light: int,
    skip: str = "",
) -> list[Quad]:
    """A lamp housing open at the bottom with the emitter set back into it.

    Args:
        centre: middle of the opening, world.
        size: outer width (x), height (y) and depth (z) of the housing, metres.
        rim: wall thickness.
        recess: distance of the emitter above the opening.
        material: of the housing.
        inside: material of the inner sides between opening and emitter.
        emitter: material of the emitter.
        light: index of the light.
        skip: outer faces that touch another surface.
    """
    half = np.array([size[0] / 2, 0.0, size[2] / 2])
    lo, hi = np.asarray(centre) - half, np.asarray(centre) + half + (0.0, size[1], 0.0)
    inset = np.array([rim, 0.0, rim])
    inner_lo, inner_hi = lo + inset, hi - inset
    inner_hi[1] = lo[1] + recess
    quads = box(lo, hi, material, skip=f"-y {skip}")
    bottom = box_face(lo, hi, "-y", material)
    along_e1, along_e2 = float(np.linalg.norm(bottom.e1)), float(np.linalg.norm(bottom.e2))
    quads += wall_with_hole(bottom, (rim, along_e1 - rim), (rim, along_e2 - rim))
    quads += [box_face(inner_lo, inner_hi, face, inside, inward=True) for face in ("-x", "+x", "-z", "+z")]
    quads.append(replace(box_face(inner_lo, inner_hi, "+y", emitter, inward=True), light=light))
    return quads


def transformed(quads: Iterable[Quad], world_from_local: NDArray[np.float64]) -> list[Quad]:
    """The quads moved by a rigid (4, 4) transform."""
    rotation, shift = world_from_local[:3, :3], world_from_local[:3, 3]
    return [replace(q, p0=rotation @ q.p0 + shift, e1=rotation @ q.e1, e2=rotation @ q.e2) for q in quads]


def pose(position: Vector, *, yaw: float = 0.0, roll: float = 0.0) -> NDArray[np.float64]:
    """(4, 4) float64: rotation by `roll` about z, then `yaw` about y (radians), then a shift to `position`."""
    cos_yaw, sin_yaw, cos_roll, sin_roll = np.cos(yaw), np.sin(yaw), np.cos(roll), np.sin(roll)
    about_y = np.array([[cos_yaw, 0.0, sin_yaw], [0.0, 1.0, 0.0], [-sin_yaw, 0.0, cos_yaw]])
    about_z = np.array([[cos_roll, -sin_roll, 0.0], [sin_roll, cos_roll, 0.0], [0.0, 0.0, 1.0]])
    world_from_local = np.eye(4)
    world_from_local[:3, :3] = about_y @ about_z
    world_from_local[:3, 3] = position
    return world_from_local


def with_cell_size(quads: Iterable[Quad], cell_size: float) -> list[Quad]:
    """The quads with another radiosity cell size in metres."""
    return [replace(q, cell_size=cell_size) for q in quads]
