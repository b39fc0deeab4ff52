"""Irradiance on virtual objects, computed from a light packet as the client shades it, but with ray-cast visibility.

Per point: every VAL in disc form times the part of its disc that room and virtual objects leave visible, plus the transfer
of the object times the SH of the indirect light, plus the self-interreflection of the VALs' light (the bounce part of the
transfer times the VALs' own SH at the object's centre), less what the object takes from the surface that it stands on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nearfield_server.radiometry.form_factor import val_irradiance
from nearfield_server.radiometry.sh import rotate_sh, sh_basis
from nearfield_server.scene.ground_shadow import ground_reflectance
from nearfield_server.scene.prepared_model import PreparedModel
from nearfield_server.scene.ray_caster import RayCaster

DISC_SAMPLES = 32
_SURE_RADIUS = np.sqrt(0.75)
# Rays start this far above a surface and end this far before a light: well above the rounding of float32 rays and of quantised
# VAL positions
# (a 65535th of the room), well below what casts a shadow that is seen.
_START_GAP = 2e-4
_END_GAP = 1e-2
# A point within this of a vertex is that vertex.
_SAME_POINT = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedObject:
    """A prepared model in the room.

    Attributes:
        model: geometry and transfer. albedo: (3,) linear. world_from_object: (4, 4).
    """

    model: PreparedModel
    albedo: NDArray[np.float64]
    world_from_object: NDArray[np.float64]

    @property
    def positions_world(self) -> NDArray[np.float64]:
        """(V, 3) vertices in the room."""
        return np.asarray(
            self.model.positions @ self.world_from_object[:3, :3].T + self.world_from_object[:3, 3]
        )

    @property
    def centre_world(self) -> NDArray[np.float64]:
        """(3,) where the SH are taken."""
        return np.asarray(self.world_from_object[:3, :3] @ self.model.centre + self.world_from_object[:3, 3])


@dataclass(frozen=True, slots=True, kw_only=True)
class IrradianceParts:
    """Irradiance at points, (P, 3) W/m^2 each.

    Attributes:
        direct: of the VALs.
        indirect: of the SH, less what the object takes from the ground.
        bounced: VAL light that the object sends to itself.
    """

    direct: NDArray[np.float64]
    indirect: NDArray[np.float64]
    bounced: NDArray[np.float64]

    @property
    def total(self) -> NDArray[np.float64]:
        """Sum of the parts."""
        return self.direct + self.indirect + self.bounced


def make_caster(
    room_positions: NDArray[np.floating], room_faces: NDArray[np.integer], objects: Sequence[PlacedObject]
) -> RayCaster:
    """Ray caster over the room (world axes) and all virtual objects."""
    positions, faces = [np.asarray(room_positions, np.float64)], [np.asarray(room_faces, np.int64)]
    for item in objects:
        faces.append(item.model.faces.astype(np.int64) + sum(len(p) for p in positions))
        positions.append(item.positions_world)
    return RayCaster(np.concatenate(positions), np.concatenate(faces))


def estimate_irradiance(
    points: NDArray[np.floating],
    normals: NDArray[np.floating],
    object_index: NDArray[np.integer],
    *,
    vals: NDArray[np.void],
    object_sh: NDArray[np.floating],
    objects: Sequence[PlacedObject],
    caster: RayCaster,
    room_caster: RayCaster,
    room_albedo: NDArray[np.floating],
) -> IrradianceParts:
    """Irradiance at surface points of virtual objects.

    Args:
        points: (P, 3) world.
        normals: (P, 3) unit, world.
        object_index: (P,) which object each point belongs to.
        vals: nearfield_protocol.codec.VAL_DTYPE.
        object_sh: (objects, 9, 3) sh_coeffs in world axes.
        objects: in packet order.
        caster: room and virtual objects.
        room_caster: room alone (the bounce part sees the VALs past the object itself).
        room_albedo: (F, 3) of the faces of the room alone.
    """
    where, facing = np.asarray(points, np.float64), np.asarray(normals, np.float64)
    lit = vals[np.any(vals["radiant_intensity"] > 0.0, axis=1)]
    direct = direct_irradiance(where, facing, lit, caster)
    indirect, bounced = np.zeros_like(direct), np.zeros_like(direct)
    for index, item in enumerate(objects):
        mine = np.flatnonzero(object_index == index)
        if not len(mine):
            continue
        object_from_world = np.linalg.inv(item.world_from_object)
        local_points = where[mine] @ object_from_world[:3, :3].T + object_from_world[:3, 3]
        weights = interpolation(item.model, local_points, facing[mine] @ object_from_world[:3, :3].T)
        total = np.einsum("pc,pcki->pki", weights[1], item.model.transfer.total(item.albedo)[weights[0]])
        shadowed = np.einsum("pc,pck->pk", weights[1], item.model.transfer.shadowed[weights[0]])
        sh = rotate_sh(np.asarray(object_sh[index], np.float64), object_from_world[:3, :3])
        val_sh = rotate_sh(val_sh_coeffs(item.centre_world, lit, room_caster), object_from_world[:3, :3])
        low, high = item.model.positions.min(axis=0), item.model.positions.max(axis=0)
        reflectance = ground_reflectance(
            low, high, item.model.radius, item.world_from_object, room_caster, room_albedo
        )
        ground = np.einsum("pc,pck->pk", weights[1], item.model.ground_shadow[weights[0]])
        bounced[mine] = np.einsum("pki,ki->pi", total - shadowed[..., None], val_sh)
        arriving = np.einsum("pki,ki->pi", total, sh) - reflectance * (ground @ (sh + val_sh))
        # As the client does: no surface reflects less than nothing.
        indirect[mine] = np.maximum(arriving + bounced[mine], 0.0) - bounced[mine]
    return IrradianceParts(direct=direct, indirect=indirect, bounced=bounced)


def direct_irradiance(
    points: NDArray[np.float64], normals: NDArray[np.float64], vals: NDArray[np.void], caster: RayCaster
) -> NDArray[np.float64]:
    """Irradiance of all VALs in disc form times the visible part of each disc: (P, 3)."""
    result = np.zeros((len(points), 3))
    starts = points + _START_GAP * normals
    for val in vals:
        open_irradiance = val_irradiance(
            points, normals, val["position"], val["normal"], val["radiant_intensity"], float(val["area"])
        )
        facing = np.flatnonzero(open_irradiance.any(axis=1))
        seen = visible_part(starts[facing], disc_points(val, DISC_SAMPLES), caster)
        result[facing] += seen[:, None] * open_irradiance[facing]
    return result


def visible_part(
    starts: NDArray[np.float64], targets: NDArray[np.float64], caster: RayCaster
) -> NDArray[np.float64]:
    """Share of the targets (s, 3) that each start (n, 3) sees: (n,) in [0, 1]."""
    offset = targets[None] - starts[:, None]
    distance = np.linalg.norm(offset, axis=2)
    directions = offset / np.maximum(distance, 1e-12)[..., None]
    blocked = caster.blocked(
        np.repeat(starts, len(targets), axis=0),
        directions.reshape(-1, 3),
        np.maximum(distance - _END_GAP, 0.0).reshape(-1),
    )
    return np.asarray(1.0 - blocked.reshape(len(starts), len(targets)).mean(axis=1))


def disc_points(val: np.void, count: int) -> NDArray[np.float64]:
    """Even points on the disc of a VAL (sunflower pattern, equal areas): (count, 3) world.

    Only the part of the disc that lies on a square emitter of the same second moment is used: beyond it the points may stand
    inside the housing of the lamp. The client uses the same part.
    """
    normal = np.asarray(val["normal"], np.float64)
    radius = _SURE_RADIUS * np.sqrt(float(val["area"]) / np.pi)
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    tangent = np.cross(normal, helper)
    tangent /= np.linalg.norm(tangent)
    bitangent = np.cross(normal, tangent)
    index = np.arange(count) + 0.5
    r, angle = radius * np.sqrt(index / count), index * np.pi * (3.0 - np.sqrt(5.0))
    plane = (r * np.cos(angle))[:, None] * tangent + (r * np.sin(angle))[:, None] * bitangent
    return np.asarray(np.asarray(val["position"], np.float64) + plane)


def val_sh_coeffs(
    point: NDArray[np.float64], vals: NDArray[np.void], room_caster: RayCaster
) -> NDArray[np.float64]:
    """SH of the VALs' light arriving at a point, world axes, through the room alone: (9, 3).

    Each VAL is taken as light from one direction with the irradiance that it gives a receiver facing it.
    """
    result = np.zeros((9, 3))
    for val in vals:
        offset = np.asarray(val["position"], np.float64) - point
        distance = float(np.linalg.norm(offset))
        if distance == 0.0:
            continue
        direction = offset / distance
        facing = val_irradiance(
            point, direction, val["position"], val["normal"], val["radiant_intensity"], float(val["area"])
        )
        seen = visible_part(point[None], disc_points(val, DISC_SAMPLES), room_caster)[0]
        result += seen * sh_basis(direction)[:, None] * facing
    return result


def interpolation(
    model: PreparedModel, points: NDArray[np.float64], normals: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Vertices and weights that give values at points of the surface, object axes: (P, 3) indices and (P, 3) weights.

    A point on a vertex takes that vertex; among several at one place (seams) the one of the most similar normal. Other points are
    interpolated on the face under them.
    """
    positions = model.positions.astype(np.float64)
    vertices, weights = np.zeros((len(points), 3), np.int64), np.zeros((len(points), 3))
    weights[:, 0] = 1.0
    _, vertices[:, 0] = cKDTree(positions).query(points)
    found, near = cKDTree(positions), _SAME_POINT
    for i, close in enumerate(found.query_ball_point(points, near)):
        if close:
            vertices[i, 0] = max(close, key=lambda v: float(model.normals[v] @ normals[i]))
    away = np.flatnonzero(np.linalg.norm(positions[vertices[:, 0]] - points, axis=1) > near)
    if len(away):
        reach = 0.01 * model.radius
        hits = RayCaster(positions, model.faces).closest(points[away] + reach * normals[away], -normals[away])
        on_face = (hits.face >= 0) & (hits.distance < 2.0 * reach)
        vertices[away[on_face]] = model.faces[hits.face[on_face]]
        u, v = hits.u[on_face], hits.v[on_face]
        weights[away[on_face]] = np.stack([1.0 - u - v, u, v], axis=1)
    return vertices, weights


def rel_rmse(estimate: NDArray[np.floating], truth: NDArray[np.floating]) -> float:
    """RMSE over points and channels over the mean of the truth."""
    return float(np.sqrt(np.mean((estimate - truth) ** 2)) / np.mean(truth))


def bias(estimate: NDArray[np.floating], truth: NDArray[np.floating]) -> float:
    """Mean error over the mean of the truth."""
    return float(np.mean(estimate - truth) / np.mean(truth))


def median_rel(estimate: NDArray[np.floating], truth: NDArray[np.floating]) -> float:
    """Median over the points of the mean absolute error of a point, over the mean of the truth."""
    return float(np.median(np.mean(np.abs(estimate - truth), axis=1)) / np.mean(truth))
