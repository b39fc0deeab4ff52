"""What one camera sees of the room: the surface behind every pixel, and which texels are in free sight."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nearfield_calibration.fisheye import pixels_per_steradian, project, unproject
from nearfield_server.records import CameraModel, RoomMesh, TexelGeometry
from nearfield_server.scene.ray_caster import RayCaster

# Start and end of sight lines stay clear of the surfaces by this share of the room's extent (float32 ray casting resolves 1e-7).
CLEARANCE = 2e-5
# Below this cosine a surface is seen edge-on and its pixels are worth nothing.
MIN_COSINE = 0.02


class RoomRays:
    """Ray casting in the room, in coordinates around its centre (float32 keeps full precision there)."""

    def __init__(self, mesh: RoomMesh) -> None:
        low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
        self.centre = 0.5 * (low + high)
        self.extent = float((high - low).max())
        # Texel positions are float32 in world axes: far from the origin a small room's are rounded by more than that share.
        rounding = float(np.spacing(np.float32(np.abs(mesh.positions).max())))
        self.clearance = max(CLEARANCE * self.extent, 2.0 * rounding)
        self._caster = RayCaster(mesh.positions - self.centre, mesh.faces)

    def first_face(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
        """Triangle (n,) int32 or -1 and its second and third barycentric coordinate, seen from one point."""
        origins = np.broadcast_to((origin - self.centre).astype(np.float32), directions.shape)
        hits = self._caster.closest(origins, directions)
        return hits.face, hits.u, hits.v

    def free_sight(
        self, starts: NDArray[np.float64], directions: NDArray[np.float64], distances: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Whether nothing lies between each start and the point at `distances` along `directions`."""
        return ~self._caster.blocked(starts - self.centre, directions, distances)


class Sight(NamedTuple):
    """Texels that a camera sees; all arrays (n,) or (n, 2).

    Attributes:
        texel: int64 positions in texel order.
        pixel: (n, 2) float64 (x, y).
        density: float64 camera pixels per square metre of the surface.
        theta: float64 angle to the optical axis, radians.
    """

    texel: NDArray[np.int64]
    pixel: NDArray[np.float64]
    density: NDArray[np.float64]
    theta: NDArray[np.float64]


def visible_texels(
    rays: RoomRays, texels: TexelGeometry, texel_normals: NDArray[np.float64], camera: CameraModel
) -> Sight:
    """Texels in exact free sight of a camera that face it, inside its image circle and picture.

    Args:
        rays: of the room.
        texels: texel records.
        texel_normals: (N, 3) float64 geometric normals.
        camera: lens and pose.
    """
    lens = camera.intrinsics
    eye = camera.world_from_camera[:3, 3]
    offset = eye - texels.position.astype(np.float64)
    distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
    cosine = (offset * texel_normals).sum(axis=1) / distance
    texel = np.flatnonzero(cosine > MIN_COSINE)
    pixel, valid = project(-offset[texel] @ camera.world_from_camera[:3, :3], lens)
    with np.errstate(invalid="ignore"):
        valid &= (pixel >= 0).all(axis=1) & (pixel[:, 0] < lens.width - 1) & (pixel[:, 1] < lens.height - 1)
    texel, pixel = texel[valid], pixel[valid]
    clearance = rays.clearance
    starts = texels.position[texel].astype(np.float64) + clearance * texel_normals[texel]
    to_eye = eye - starts
    length = np.maximum(np.linalg.norm(to_eye, axis=1), 1e-9)
    free = rays.free_sight(starts, to_eye / length[:, None], np.maximum(length - clearance, 0.0))
    texel, pixel = texel[free], pixel[free]
    axis = camera.world_from_camera[:3, 2]
    along = -(offset[texel] @ axis) / distance[texel]
    across = np.sqrt(np.maximum(1 - along * along, 0.0))
    theta = np.arctan2(across, along)
    density = pixels_per_steradian(theta, lens) * cosine[texel] / distance[texel] ** 2
    return Sight(texel, pixel, density, theta)


def pixel_surfaces(
    rays: RoomRays,
    groups: NDArray[np.int32],
    normals: NDArray[np.float64],
    camera: CameraModel,
    pixels: NDArray[np.float64],
) -> NDArray[np.int32]:
    """Surface number seen at each of (n, 2) pixel positions, or -1 (outside the circle, nothing, or a back face)."""
    directions_camera, valid = unproject(pixels, camera.intrinsics)
    directions = directions_camera[valid] @ camera.world_from_camera[:3, :3].T
    face, _, _ = rays.first_face(camera.world_from_camera[:3, 3], directions)
    front = (face >= 0) & ((normals[face] * directions).sum(axis=1) < 0)
    surfaces = np.full(len(pixels), -1, dtype=np.int32)
    surfaces[valid] = np.where(front, groups[face], -1)
    return surfaces
