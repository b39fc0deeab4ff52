"""Plain data that describes a room to be path-traced: no tracing, no input or output.

Frames, units and names follow protocol/CONVENTIONS.md: world is right-handed, +y up, metres; cameras are OpenCV frames.
All surfaces are Lambertian and one-sided; the back of a surface is black.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Quad:
    """A parallelogram `p0 + u e1 + v e2`, u and v in [0, 1]; its front normal is e1 x e2.

    Attributes:
        p0: (3,) float64 corner, metres.
        e1: (3,) float64 edge.
        e2: (3,) float64 edge, perpendicular to e1.
        material: key of `Scene.materials`.
        light: index of the light this quad is the emitter of, or -1.
        cell_size: longest edge of a radiosity cell, metres.
    """

    p0: NDArray[np.float64]
    e1: NDArray[np.float64]
    e2: NDArray[np.float64]
    material: str
    light: int = -1
    cell_size: float = 0.04

    @property
    def normal(self) -> NDArray[np.float64]:
        """(3,) float64 unit front normal."""
        cross = np.cross(self.e1, self.e2)
        return np.asarray(cross / np.linalg.norm(cross))

    @property
    def area(self) -> float:
        """Area in m^2."""
        return float(np.linalg.norm(np.cross(self.e1, self.e2)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """A switchable light: one rectangular, one-sided, Lambertian emitter.

    Attributes:
        name: identifier.
        kind: one line for people.
        radiance: nominal radiance per channel, W/(sr m^2).
        basis_radiance: white radiance of the basis pictures.
    """

    name: str
    kind: str
    radiance: Vector
    basis_radiance: float = 100.0


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualObject:
    """A virtual object, local frame in metres with its lowest vertex at y = 0.

    Attributes:
        name: identifier and file stem.
        positions: (V, 3) float64, object frame.
        faces: (F, 3) int32, counter-clockwise from outside.
        normals: (V, 3) float64 unit, area-weighted vertex normals.
        albedo: linear diffuse albedo.
        world_from_object: (4, 4) float64.
        source: where the model came from and under which terms.
    """

    name: str
    positions: NDArray[np.float64]
    faces: NDArray[np.int32]
    normals: NDArray[np.float64]
    albedo: Vector
    world_from_object: NDArray[np.float64]
    source: str

    @property
    def positions_world(self) -> NDArray[np.float64]:
        """(V, 3) float64 vertex positions in the world frame."""
        return np.asarray(self.positions @ self.world_from_object[:3, :3].T + self.world_from_object[:3, 3])

    @property
    def normals_world(self) -> NDArray[np.float64]:
        """(V, 3) float64 unit vertex normals in the world frame (poses are rigid)."""
        return np.asarray(self.normals @ self.world_from_object[:3, :3].T)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """A camera with its pose; `model` is "equidistant", "kannala_brandt" or "pinhole".

    Attributes:
        model: lens model (CONVENTIONS.md, fish-eye formula; `k` is ignored for "pinhole").
        width: pixels. height: pixels.
        fx, fy, cx, cy: pixels.
        k: Kannala-Brandt coefficients k1..k4.
        theta_max: radians, limit of the image circle (fish-eye only).
        world_from_camera: (4, 4) float64.
    """

    model: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_from_camera: NDArray[np.float64]
    k: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    theta_max: float = float(np.pi / 2)

    @property
    def is_fisheye(self) -> bool:
        """Whether the lens is a fish-eye."""
        return self.model != "pinhole"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sequence:
    """Light weights over time: `weights` is (frames, lights) float64 at `fps` frames per second."""

    name: str
    weights: NDArray[np.float64]
    fps: int = 30


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Everything the generator needs to know of a room.

    Attributes:
        name: room name.
        size: interior extent [0, x] x [0, y] x [0, z], metres.
        materials: name -> linear diffuse albedo.
        quads: real surfaces, emitters included.
        lights: switchable lights; light k has exactly one quad with `light == k`.
        objects: virtual objects. cameras: fish-eyes. views: tablets. sequences: light weights over time.
        atlas_size: largest width and height of the UV atlas, texels.
    """

    name: str
    size: Vector
    materials: dict[str, Vector]
    quads: tuple[Quad, ...]
    lights: tuple[Light, ...]
    objects: tuple[VirtualObject, ...]
    cameras: tuple[Sensor, ...]
    views: tuple[Sensor, ...]
    sequences: tuple[Sequence, ...] = field(default=())
    atlas_size: int = 1024

    def emitter(self, light: int) -> Quad:
        """The emitting quad of a light."""
        return next(quad for quad in self.quads if quad.light == light)


def look_at(eye: Vector, target: Vector) -> NDArray[np.float64]:
    """Pose of an upright camera, (4, 4) float64 world_from_camera, OpenCV axes.

    Args:
        eye: camera centre, world.
        target: point that falls onto the principal point; not straight above or below `eye`.
    """
    forward = np.asarray(target, dtype=np.float64) - np.asarray(eye, dtype=np.float64)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    world_from_camera[:3, 3] = eye
    return world_from_camera


def fisheye(size: int, eye: Vector, target: Vector, k: tuple[float, float, float, float]) -> Sensor:
    """A square fish-eye of 180 degrees whose image circle touches the border of the picture."""
    theta_max = np.pi / 2
    square = theta_max**2
    radius = theta_max * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))
    focal = float(size / 2 / radius)
    return Sensor(
        model="kannala_brandt" if any(k) else "equidistant",
        width=size,
        height=size,
        fx=focal,
        fy=focal,
        cx=(size - 1) / 2,
        cy=(size - 1) / 2,
        k=k,
        theta_max=float(theta_max),
        world_from_camera=look_at(eye, target),
    )


def tablet(width: int, height: int, eye: Vector, target: Vector, horizontal_angle: float) -> Sensor:
    """A pinhole tablet view with the given horizontal field of view in radians."""
    focal = float(width / 2 / np.tan(horizontal_angle / 2))
    return Sensor(
        model="pinhole",
        width=width,
        height=height,
        fx=focal,
        fy=focal,
        cx=(width - 1) / 2,
        cy=(height - 1) / 2,
        world_from_camera=look_at(eye, target),
    )
