"""Pictures and point irradiance from the gather estimator, as two independent halves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.virtual_lab.model import Sensor
from nearfield_server.virtual_lab.sampling import Sampler
from nearfield_server.virtual_lab.tracer import DIMENSION_PIXEL, RAY_OFFSET, Tracer

NEWTON_STEPS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedImage:
    """Radiance of a picture per unit radiance of each light.

    Attributes:
        direct: (2, K, H, W, 3) float32, emission and direct light, two independent halves.
        indirect: (2, K, H, W, 3) float32.
        coverage: (H, W) float32 share of the pixel that shows a virtual object.
        emission: (H, W) float32 share of the pixel that shows an emitter.
    """

    direct: NDArray[np.float32]
    indirect: NDArray[np.float32]
    coverage: NDArray[np.float32]
    emission: NDArray[np.float32]

    @property
    def total_halves(self) -> NDArray[np.float32]:
        """(2, K, H, W, 3) float32."""
        return self.direct + self.indirect


def pixels_in_circle(sensor: Sensor) -> NDArray[np.int64]:
    """Flat indices (row * width + column) of pixels whose centre lies inside the image circle; all pixels of a pinhole."""
    column, row = np.meshgrid(np.arange(sensor.width), np.arange(sensor.height))
    if not sensor.is_fisheye:
        return np.arange(sensor.width * sensor.height)
    radius = np.hypot((column - sensor.cx) / sensor.fx, (row - sensor.cy) / sensor.fy)
    return np.flatnonzero(radius <= _distort(sensor, sensor.theta_max))


def _distort(sensor: Sensor, theta: Any) -> Any:
    square = theta * theta
    k1, k2, k3, k4 = sensor.k
    return theta * (1 + square * (k1 + square * (k2 + square * (k3 + square * k4))))


def camera_directions(tracer: Tracer, sensor: Sensor, column: Any, row: Any) -> Any:
    """World directions (Dr.Jit Vector3f, unit) through continuous pixel coordinates, centres at integers."""
    mi, dr = tracer.backend.mi, tracer.backend.dr
    x, y = (column - sensor.cx) / sensor.fx, (row - sensor.cy) / sensor.fy
    if sensor.is_fisheye:
        radius = dr.maximum(dr.sqrt(dr.square(x) + dr.square(y)), 1e-9)
        theta = mi.Float(radius)
        k1, k2, k3, k4 = sensor.k
        for _ in range(NEWTON_STEPS if any(sensor.k) else 0):
            square = dr.square(theta)
            slope = 1 + square * (3 * k1 + square * (5 * k2 + square * (7 * k3 + square * (9 * k4))))
            theta -= (_distort(sensor, theta) - radius) / slope
        scale = dr.sin(theta) / radius
        local = mi.Vector3f(x * scale, y * scale, dr.cos(theta))
    else:
        local = dr.normalize(mi.Vector3f(x, y, 1.0))
    rotation = sensor.world_from_camera[:3, :3]
    axes = [mi.Vector3f(*map(float, rotation[:, axis])) for axis in range(3)]
    return dr.normalize(axes[0] * local.x + axes[1] * local.y + axes[2] * local.z)


def render_image(
    tracer: Tracer,
    sensor: Sensor,
    *,
    samples: int,
    gather_rays: int,
    seed: int,
    progress: Callable[[], None] = lambda: None,
) -> RenderedImage:
    """Render all basis pictures of one sensor.

    Args:
        tracer: scene with a solved cache.
        sensor: the camera.
        samples: per pixel, at least 2 and even; halves use different samples.
        gather_rays: indirect rays per sample.
        seed: equal seeds give equal noise whatever objects the scene holds.
        progress: called once per sample.
    """
    mi, dr = tracer.backend.mi, tracer.backend.dr
    pixel = pixels_in_circle(sensor)
    lane_column, lane_row = (
        mi.Float((pixel % sensor.width).astype(np.float32)),
        mi.Float((pixel // sensor.width).astype(np.float32)),
    )
    centre = mi.Point3f(*map(float, sensor.world_from_camera[:3, 3]))
    num_lights, size = tracer.num_lights, sensor.width * sensor.height
    direct, indirect = (np.zeros((2, num_lights, size, 3), dtype=np.float32) for _ in range(2))
    coverage, emission = np.zeros(size, dtype=np.float32), np.zeros(size, dtype=np.float32)
    half = samples // 2
    for part in range(2):
        sampler = Sampler(tracer.backend, mi.UInt32(pixel.astype(np.uint32)), 2 * seed + part)
        sums = [mi.Float(0.0) for _ in range(6 * num_lights + 2)]
        for sample in range(half):
            index = dr.opaque(mi.UInt32, sample)
            jitter = sampler.pair(index, DIMENSION_PIXEL)
            direction = camera_directions(
                tracer, sensor, lane_column + (jitter[0] - 0.5), lane_row + (jitter[1] - 0.5)
            )
            values = shade_rays(tracer, centre, direction, sampler, index, gather_rays)
            sums = [a + b for a, b in zip(sums, values, strict=True)]
            dr.eval(sums)
            progress()
        arrays = np.stack([s.numpy() for s in sums]) / half
        for k in range(num_lights):
            direct[part, k, pixel] = arrays[3 * k : 3 * k + 3].T
            indirect[part, k, pixel] = arrays[3 * (num_lights + k) : 3 * (num_lights + k) + 3].T
        coverage[pixel] += arrays[-2] / 2
        emission[pixel] += arrays[-1] / 2
    shape = (2, num_lights, sensor.height, sensor.width, 3)
    flat = (sensor.height, sensor.width)
    return RenderedImage(
        direct=direct.reshape(shape),
        indirect=indirect.reshape(shape),
        coverage=coverage.reshape(flat),
        emission=emission.reshape(flat),
    )


def shade_rays(
    tracer: Tracer, origin: Any, direction: Any, sampler: Sampler, index: Any, gather_rays: int
) -> list[Any]:
    """Direct radiance (3 K), indirect radiance (3 K), object coverage and emitter coverage of one ray per lane."""
    mi, dr = tracer.backend.mi, tracer.backend.dr
    hit = tracer.intersect(origin, direction)
    active = hit.is_front
    normal = tracer.shading_normal(hit)
    position = hit.position + RAY_OFFSET * hit.normal
    reflectance = tracer.albedo(hit) / dr.pi
    light = dr.select(active, dr.gather(mi.Int32, tracer.face_light, hit.face, active), -1)
    owner = dr.select(active, dr.gather(mi.Int32, tracer.face_object, hit.face, active), -1)
    irradiance = tracer.direct(position, normal, sampler, index, active)
    direct = []
    for k, value in enumerate(irradiance):
        own = dr.select(light == k, 1.0, 0.0)
        direct += [reflectance[c] * value + own for c in range(3)]
    arriving = tracer.indirect(position, normal, sampler, index, gather_rays, active)
    indirect = [reflectance[c % 3] * value for c, value in enumerate(arriving)]
    return [*direct, *indirect, dr.select(owner >= 0, 1.0, 0.0), dr.select(light >= 0, 1.0, 0.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class PointIrradiance:
    """Irradiance per unit radiance of each light, two independent halves: direct (2, N, K), indirect (2, N, K, 3), float64."""

    direct: NDArray[np.float64]
    indirect: NDArray[np.float64]


def point_irradiance(
    tracer: Tracer,
    position: NDArray[np.float64],
    normal: NDArray[np.float64],
    *,
    replicas: int,
    samples: int,
    gather_rays: int,
    seed: int,
    progress: Callable[[], None] = lambda: None,
) -> PointIrradiance:
    """Irradiance at given points with given normals.

    Args:
        tracer: scene with a solved cache.
        position: (N, 3) on a surface, world.
        normal: (N, 3) unit.
        replicas: independent lanes per point and half.
        samples: per lane.
        gather_rays: per sample.
        seed: of the sampling pattern.
        progress: called once per sample.
    """
    mi, dr = tracer.backend.mi, tracer.backend.dr
    count, num_lights = len(position), tracer.num_lights
    lanes = 2 * count * replicas
    lane_position = np.tile(position + RAY_OFFSET * normal, (2 * replicas, 1)).T.astype(np.float32)
    lane_normal = np.tile(normal, (2 * replicas, 1)).T.astype(np.float32)
    point, shading = (
        mi.Point3f(np.ascontiguousarray(lane_position)),
        mi.Normal3f(np.ascontiguousarray(lane_normal)),
    )
    sampler = Sampler(tracer.backend, dr.arange(mi.UInt32, lanes), seed)
    sums = [mi.Float(0.0) for _ in range(4 * num_lights)]
    for sample in range(samples):
        index = dr.opaque(mi.UInt32, sample)
        active = mi.Bool(True)
        values = tracer.direct(point, shading, sampler, index, active)
        values += tracer.indirect(point, shading, sampler, index, gather_rays, active)
        sums = [a + b for a, b in zip(sums, values, strict=True)]
        dr.eval(sums)
        progress()
    arrays = (
        np.stack([s.numpy() for s in sums])
        .astype(np.float64)
        .reshape(4 * num_lights, 2, replicas, count)
        .mean(axis=2)
        / samples
    )
    direct = np.moveaxis(arrays[:num_lights], (0, 1, 2), (2, 0, 1))
    indirect = np.moveaxis(arrays[num_lights:].reshape(num_lights, 3, 2, count), (0, 1, 2, 3), (2, 3, 0, 1))
    return PointIrradiance(direct=direct, indirect=indirect)
