"""Ray casting and the gather estimator: irradiance at surface points from every light at once.

Reflected radiance is `albedo / pi (E_direct + E_indirect)`. E_direct comes from next-event estimation on each emitter, E_indirect from
cosine-distributed rays into a converged radiosity cache (`radiosity`). All lights share the paths, and the samples of a lane depend
only on its key, so pictures with and without the virtual objects have the same noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.virtual_lab.backend import Backend
from nearfield_server.virtual_lab.geometry import Geometry
from nearfield_server.virtual_lab.model import Scene
from nearfield_server.virtual_lab.sampling import Sampler

# Rays start this far (metres) off a surface: about 100 times the float32 rounding of a coordinate of 6 m, far below any real gap.
RAY_OFFSET = 4e-5
# Below this solid angle (sr) float32 spherical excess loses digits while plain area sampling is already almost noise-free.
MIN_SPHERICAL_SAMPLING = 0.03
# Gather rays that end closer than this (metres, more than a radiosity cell) do not trust the cell: at contacts between surfaces
# the light changes within one cell.
NEAR_DISTANCE = 0.06
# Dimension pairs of a lane's samples; light k uses DIMENSION_LIGHT + k,
# the second bounce those after it.
DIMENSION_PIXEL, DIMENSION_GATHER, DIMENSION_LIGHT = 0, 1, 2


@dataclass(slots=True)
class Hit:
    """First surface along a ray; fields are Dr.Jit arrays, valid where `is_front`."""

    is_front: Any
    is_back: Any
    face: Any
    barycentric: Any
    position: Any
    normal: Any


class Tracer:
    """A scene ready for ray casting."""

    def __init__(self, backend: Backend, scene: Scene, geometry: Geometry) -> None:
        self.backend, self.scene, self.geometry = backend, scene, geometry
        mi = backend.mi
        mesh = mi.Mesh("room", len(geometry.positions), len(geometry.faces))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = mi.Float(
            np.ascontiguousarray(geometry.positions, dtype=np.float32).ravel()
        )
        parameters["faces"] = mi.UInt32(geometry.faces.astype(np.uint32).ravel())
        parameters.update()
        self._rays = mi.load_dict({"type": "scene", "mesh": mesh})
        self._face_normal = self._table(geometry.face_normal)
        self._corner_normals = self._table(geometry.normals[geometry.faces].reshape(-1, 9))
        self._albedo = self._table(geometry.face_albedo)
        self._frame = self._table(np.hstack([geometry.face_origin, geometry.face_u, geometry.face_v]))
        self._grid = mi.UInt32(
            np.stack([geometry.face_cell, geometry.cells_u, geometry.cells_v], 1).astype(np.uint32).ravel()
        )
        self.face_light = mi.Int32(geometry.face_light)
        self.face_object = mi.Int32(geometry.face_object)
        self._cache: Any = None

    @property
    def num_lights(self) -> int:
        """Number of switchable lights."""
        return len(self.scene.lights)

    def set_cache(self, reflected_radiance: NDArray[np.float64]) -> None:
        """Store the reflected radiance of all cells, (C, lights, 3), per unit radiance of each light."""
        self._cache = self.backend.mi.Float(
            np.ascontiguousarray(reflected_radiance, dtype=np.float32).ravel()
        )

    def _table(self, values: NDArray[np.float64]) -> Any:
        return self.backend.mi.Float(np.ascontiguousarray(values, dtype=np.float32).ravel())

    def _row(self, table: Any, index: Any, width: int, start: int, active: Any) -> Any:
        dr, mi = self.backend.dr, self.backend.mi
        return mi.Vector3f(
            *[dr.gather(mi.Float, table, index * width + (start + c), active) for c in range(3)]
        )

    def intersect(self, origin: Any, direction: Any, active: Any = True) -> Hit:
        """Closest hit of each ray."""
        dr, mi = self.backend.dr, self.backend.mi
        found = self._rays.ray_intersect_preliminary(mi.Ray3f(origin, direction), False, active=active)
        valid = found.is_valid() & active
        normal = self._row(self._face_normal, found.prim_index, 3, 0, valid)
        front = dr.dot(normal, direction) < 0
        position = origin + direction * dr.select(valid, found.t, 0.0)
        return Hit(
            valid & front, valid & ~front, found.prim_index, found.prim_uv, mi.Point3f(position), normal
        )

    def shading_normal(self, hit: Hit) -> Any:
        """Interpolated vertex normal at front hits (the geometric normal on quads)."""
        return self.interpolated_normal(hit.face, hit.barycentric.x, hit.barycentric.y, hit.is_front)

    def interpolated_normal(self, face: Any, u: Any, v: Any, active: Any) -> Any:
        """Unit vertex normal interpolated at barycentric coordinates (1 - u - v, u, v) of a triangle."""
        dr, mi = self.backend.dr, self.backend.mi
        corners = [self._row(self._corner_normals, face, 9, 3 * c, active) for c in range(3)]
        blend = corners[0] * (1 - u - v) + corners[1] * u + corners[2] * v
        return mi.Normal3f(dr.normalize(dr.select(active, blend, mi.Vector3f(0.0, 1.0, 0.0))))

    def albedo(self, hit: Hit) -> Any:
        """Diffuse albedo at front hits, 0 elsewhere."""
        return self._row(self._albedo, hit.face, 3, 0, hit.is_front)

    def cell(self, hit: Hit) -> Any:
        """Radiosity cell of each front hit (UInt32)."""
        dr, mi = self.backend.dr, self.backend.mi
        first, num_u, num_v = (
            dr.gather(mi.UInt32, self._grid, hit.face * 3 + c, hit.is_front) for c in range(3)
        )
        offset = mi.Vector3f(hit.position) - self._row(self._frame, hit.face, 9, 0, hit.is_front)
        u = dr.dot(offset, self._row(self._frame, hit.face, 9, 3, hit.is_front))
        v = dr.dot(offset, self._row(self._frame, hit.face, 9, 6, hit.is_front))
        column = dr.clip(mi.Int32(u * mi.Float(num_u)), 0, mi.Int32(num_u) - 1)
        row = dr.clip(mi.Int32(v * mi.Float(num_v)), 0, mi.Int32(num_v) - 1)
        return mi.UInt32(mi.Int32(first) + row * mi.Int32(num_u) + column)

    def gather_direction(self, normal: Any, u: Any, v: Any) -> Any:
        """Cosine-distributed direction about a normal."""
        mi = self.backend.mi
        return mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(u, v)))

    def direct(
        self,
        position: Any,
        normal: Any,
        sampler: Sampler,
        index: Any,
        active: Any,
        dimension: int = DIMENSION_LIGHT,
    ) -> list[Any]:
        """One-sample estimate of the irradiance from each light of unit radiance.

        Args:
            position: already moved off its surface.
            normal: shading normal, unit.
            sampler: numbers.
            index: sample index.
            active: lanes that count; others get 0.
            dimension: first dimension pair of the samples.

        Returns:
            One Float per light, W/m^2 per W/(sr m^2).
        """
        dr, mi = self.backend.dr, self.backend.mi
        result = []
        for k in range(self.num_lights):
            u, v = sampler.pair(index, dimension + k)
            target, weight = self._sample_emitter(position, k, u, v)
            offset = target - mi.Vector3f(position)
            distance = dr.norm(offset)
            direction = offset / distance
            cosine = dr.dot(direction, normal)
            useful = active & (cosine > 0) & (weight > 0)
            ray = mi.Ray3f(
                position, direction, maxt=distance * (1 - 2e-5) - RAY_OFFSET, time=0.0, wavelengths=[]
            )
            blocked = self._rays.ray_test(ray, active=useful)
            result.append(dr.select(useful & ~blocked, cosine * weight, 0.0))
        return result

    def _sample_emitter(self, position: Any, light: int, u: Any, v: Any) -> tuple[Any, Any]:
        """A point on emitter `light` and its weight 1 / pdf in solid angle (0 behind the emitter).

        Spherical-rectangle sampling (Urena, Fajardo and King 2013) where the emitter looks big, uniform area sampling elsewhere.
        """
        dr, mi = self.backend.dr, self.backend.mi
        emitter = self.scene.emitter(light)
        size_x, size_y = float(np.linalg.norm(emitter.e1)), float(np.linalg.norm(emitter.e2))
        axis_x, axis_y, axis_z = (
            mi.Vector3f(*map(float, a)) for a in (emitter.e1 / size_x, emitter.e2 / size_y, emitter.normal)
        )
        corner = mi.Vector3f(*map(float, emitter.p0)) - mi.Vector3f(position)
        x0, y0 = dr.dot(corner, axis_x), dr.dot(corner, axis_y)
        height = -dr.dot(corner, axis_z)
        z0 = -dr.maximum(height, 1e-6)
        x1, y1 = x0 + size_x, y0 + size_y
        normals = []
        for (ax, ay), (bx, by) in zip(
            ((x0, y0), (x1, y0), (x1, y1), (x0, y1)), ((x1, y0), (x1, y1), (x0, y1), (x0, y0)), strict=True
        ):
            normals.append(dr.normalize(dr.cross(mi.Vector3f(ax, ay, z0), mi.Vector3f(bx, by, z0))))
        angles = [dr.safe_acos(-dr.dot(normals[c], normals[(c + 1) % 4])) for c in range(4)]
        rest = 2 * dr.pi - angles[2] - angles[3]
        solid_angle = angles[0] + angles[1] - rest
        turned = u * solid_angle + rest
        factor = (dr.cos(turned) * normals[0].z - normals[2].z) / dr.sin(turned)
        cosine = dr.clip(dr.copysign(dr.rsqrt(dr.square(factor) + dr.square(normals[0].z)), factor), -1, 1)
        x = dr.clip(-(cosine * z0) / dr.maximum(dr.safe_sqrt(1 - dr.square(cosine)), 1e-7), x0, x1)
        reach = dr.sqrt(dr.square(x) + dr.square(z0))
        low, high = (
            y0 * dr.rsqrt(dr.square(reach) + dr.square(y0)),
            y1 * dr.rsqrt(dr.square(reach) + dr.square(y1)),
        )
        slope = low + v * (high - low)
        y = dr.clip(slope * reach * dr.rsqrt(dr.maximum(1 - dr.square(slope), 1e-7)), y0, y1)
        is_spherical = solid_angle > MIN_SPHERICAL_SAMPLING
        x, y = dr.select(is_spherical, x, x0 + u * size_x), dr.select(is_spherical, y, y0 + v * size_y)
        square = dr.square(x) + dr.square(y) + dr.square(z0)
        area_weight = size_x * size_y * -z0 / (square * dr.sqrt(square))
        target = mi.Vector3f(position) + x * axis_x + y * axis_y + z0 * axis_z
        return target, dr.select(height > 1e-6, dr.select(is_spherical, solid_angle, area_weight), 0.0)

    def indirect(
        self, position: Any, normal: Any, sampler: Sampler, index: Any, rays: int, active: Any
    ) -> list[Any]:
        """Estimate of the irradiance that arrives from reflecting surfaces, `rays` cosine-distributed rays.

        Returns:
            lights x 3 Floats (light-major), W/m^2 per unit radiance of the light.
        """
        dr, mi = self.backend.dr, self.backend.mi
        first = index * rays

        def trace(sample: Any) -> Hit:
            direction = self.gather_direction(normal, *sampler.pair(sample, DIMENSION_GATHER))
            return self.intersect(position, direction, active)

        hit = trace(first)
        arriving = self.cached_radiance(hit)
        near = hit.is_front & (dr.squared_norm(hit.position - position) < NEAR_DISTANCE**2)
        exact = self._second_bounce(hit, near, sampler, index)
        total = [a + rays * dr.select(near, e - a, 0.0) for a, e in zip(arriving, exact, strict=True)]

        # A recorded loop: unrolled, the compiler would need minutes for 16 rays and 7 lights.
        def body(ray: Any, *sums: Any) -> tuple[Any, ...]:
            values = self.cached_radiance(trace(first + ray))
            return (ray + 1, *[a + b for a, b in zip(sums, values, strict=True)])

        state = dr.while_loop((mi.UInt32(1), *total), lambda ray, *_: ray < dr.opaque(mi.UInt32, rays), body)
        return [value * (dr.pi / rays) for value in state[1:]]

    def cached_radiance(self, hit: Hit) -> list[Any]:
        """Reflected radiance of the cell at each front hit: lights x 3 Floats, 0 elsewhere."""
        dr, mi = self.backend.dr, self.backend.mi
        base = self.cell(hit) * (3 * self.num_lights)
        return [dr.gather(mi.Float, self._cache, base + c, hit.is_front) for c in range(3 * self.num_lights)]

    def _second_bounce(self, hit: Hit, near: Any, sampler: Sampler, index: Any) -> list[Any]:
        """Reflected radiance at near hits without their own cell: direct light, and one gather ray into the cache.

        It replaces the cached value of the first of a set of gather rays that have equal distributions, times their number: a control
        variate, unbiased for all of them at the price of one.
        """
        dr = self.backend.dr
        normal = self.shading_normal(hit)
        position = hit.position + RAY_OFFSET * hit.normal
        first = DIMENSION_LIGHT + self.num_lights
        irradiance = self.direct(position, normal, sampler, index, near, first)
        direction = self.gather_direction(normal, *sampler.pair(index, first + self.num_lights))
        beyond = self.cached_radiance(self.intersect(position, direction, near))
        albedo = self.albedo(hit)
        return [albedo[c % 3] * (irradiance[c // 3] / dr.pi + value) for c, value in enumerate(beyond)]
