"""The gather table: for each texel, which pixels of which cameras show it (Rohmer et al. 2014, section 4.1).

Differs from the paper: visibility is exact (ray casting, not a depth map with a bias), and every tap is validated. A pixel
takes part only when its whole 3x3 neighbourhood shows the texel's own surface and no visible border of a surface comes
near. Otherwise the bright rim of a lamp bleeds
onto whatever lies behind it in the picture, which is the largest error of a plain projection by far.

Weights: the paper weighs by the angle to the camera's main axis. Here the weight is the number of pixels that the camera
spends on a square metre at the texel (distance, grazing angle and lens resolution in one), times a taper that goes to
zero at the rim of the image circle as in the paper.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from nearfield_server.errors import ConfigError
from nearfield_server.geometry.camera_view import RoomRays, Sight, pixel_surfaces, visible_texels
from nearfield_server.geometry.face_groups import face_groups
from nearfield_server.geometry.silhouettes import boundary_edges, find_borders
from nearfield_server.geometry.texels import face_normals
from nearfield_server.records import CameraModel, GatherTable, RoomMesh, TexelGeometry, UnseenFill

# Pairs below this share of the texel's best weight are left out, those above it fade in. Measured on the Cornell bundle (four
# cameras, share 0 / 0.1 / 0.5): 2.4 / 2.0 / 1.3 million pairs, relative RMS error 1.96 / 1.92 / 1.81 % of the texels' radiance:
# a second, worse view of a texel only adds its own errors.
MIN_RELATIVE_WEIGHT = 0.5
# Pairs that had to be snapped to another pixel count less than interpolated ones.
SNAP_WEIGHT = 0.25
# How far (pixels) a texel may be snapped.
SNAP_RADIUS = 3
# Sub-pixel positions that must show one surface before a pixel without a pure neighbourhood is used (half a pixel and a
# tenth, because lens and demosaicking blur a little beyond the pixel).
_SUBPIXELS = np.linspace(-0.6, 0.6, 5)
# Below this albedo in all channels a surface counts as black.
BLACK_ALBEDO = 0.02
# Positions at which the share of a pixel's area is measured.
_PIXEL_AREA = (np.arange(8) + 0.5) / 8 - 0.5
# Metres that count as much as the distance between two unit normals of 1, and as an albedo difference of 1.
_NORMAL_METRES, _ALBEDO_METRES = 0.3, 1.0
_MAX_CANDIDATES = 40_000
Progress = Callable[[str, float], None]


class _Pairs(NamedTuple):
    texel: NDArray[np.int64]
    pixel: NDArray[np.int64]
    fraction: NDArray[np.float32]
    weight: NDArray[np.float64]


def build_gather_table(
    mesh: RoomMesh, texels: TexelGeometry, cameras: Sequence[CameraModel], *, progress: Progress | None = None
) -> GatherTable:
    """Build the table by ray casting.

    Args:
        mesh: room.
        texels: texel records of the room.
        cameras: one to 255 fish-eye cameras.
        progress: called with a text and the share of work done in [0, 1].

    Raises:
        ConfigError: no camera, or too many.
    """
    if not 1 <= len(cameras) <= 255:
        raise ConfigError(f"cameras: expected 1 to 255, found {len(cameras)}.")
    rays = RoomRays(mesh)
    groups, normals = face_groups(mesh), face_normals(mesh)
    texel_groups, texel_normals = groups[texels.face], normals[texels.face]
    edges = boundary_edges(mesh, groups)
    sights: list[Sight] = []
    pictures: list[NDArray[np.int32]] = []
    parts: list[_Pairs] = []
    for index, camera in enumerate(cameras):
        if progress is not None:
            progress(f"camera {camera.camera_id}: sight lines", index / len(cameras))
        sight = visible_texels(rays, texels, texel_normals, camera)
        surfaces = _surface_picture(rays, groups, normals, camera)
        borders = find_borders(rays, edges, groups, normals, camera)
        usable = np.where(_uniform(surfaces) & ~borders.near, surfaces, -1)
        sights.append(sight)
        pictures.append(np.where(borders.touched, -1, surfaces))
        parts.append(_pairs(sight, texel_groups, usable, camera, bilinear=True))
    seen = np.zeros(len(texels.face), dtype=np.bool_)
    for part in parts:
        seen[part.texel] = True
    for index, camera in enumerate(cameras):
        missing = _select(sights[index], ~seen)
        if len(missing.texel):
            usable = _single_surface_pixels(rays, groups, normals, camera, pictures[index], missing)
            extra = _pairs(missing, texel_groups, usable, camera, bilinear=False)
            parts[index] = _joined(parts[index], extra)
    for part in parts:
        seen[part.texel] = True
    is_black = _black_groups(mesh, groups) & ~np.isin(np.arange(groups.max() + 1), texel_groups[seen])
    for index, camera in enumerate(cameras):
        missing = _select(sights[index], is_black[texel_groups])
        if len(missing.texel):
            extra = _pairs_of_tiny_emitters(rays, groups, normals, camera, missing, texel_groups)
            parts[index] = _joined(parts[index], extra)
    if progress is not None:
        progress("weights", 1.0)
    return _assemble(parts, len(texels.face), cameras)


def find_unseen_fill(mesh: RoomMesh, texels: TexelGeometry, table: GatherTable) -> UnseenFill:
    """For texels that no camera sees, a seen texel whose radiance is the best guess.

    That is the nearest seen texel of the same connected surface. Where the whole surface is unseen (undersides, backs), it is
    the seen texel most alike in place, direction and albedo. Black surfaces neither give nor take then: their light is
    emitted, and a lamp must not be copied onto its housing.
    """
    seen = np.diff(table.pair_start) > 0
    unseen = np.flatnonzero(~seen)
    source = np.full(len(unseen), -1, dtype=np.int32)
    texel_groups = face_groups(mesh)[texels.face]
    unseen_groups = texel_groups[unseen]
    seen_texels = np.flatnonzero(seen & np.isin(texel_groups, unseen_groups))
    for group in np.unique(texel_groups[seen_texels]):
        candidates = seen_texels[texel_groups[seen_texels] == group]
        wanted = unseen_groups == group
        _, nearest = cKDTree(texels.position[candidates]).query(texels.position[unseen[wanted]])
        source[wanted] = candidates[nearest]
    albedo = mesh.material_albedo[mesh.face_material[texels.face]]
    reflects = albedo.max(axis=1) > BLACK_ALBEDO
    candidates = np.flatnonzero(seen & reflects)
    # Texel order follows the surfaces, so every n-th texel is an even sample; a guess needs no more.
    candidates = candidates[:: max(1, len(candidates) // _MAX_CANDIDATES)]
    left = np.flatnonzero((source < 0) & reflects[unseen])
    if len(candidates) and len(left):
        features = np.hstack([texels.position, _NORMAL_METRES * texels.normal, _ALBEDO_METRES * albedo])
        _, nearest = cKDTree(features[candidates]).query(features[unseen[left]])
        source[left] = candidates[nearest]
    return UnseenFill(texel=unseen.astype(np.int32), source=source)


def _surface_picture(
    rays: RoomRays, groups: NDArray[np.int32], normals: NDArray[np.float64], camera: CameraModel
) -> NDArray[np.int32]:
    """(H, W) int32 surface number behind each pixel centre, or -1."""
    lens = camera.intrinsics
    columns, rows = np.meshgrid(
        np.arange(lens.width, dtype=np.float64), np.arange(lens.height, dtype=np.float64)
    )
    pixels = np.stack([columns.reshape(-1), rows.reshape(-1)], axis=1)
    return pixel_surfaces(rays, groups, normals, camera, pixels).reshape(lens.height, lens.width)


def _uniform(surfaces: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(H, W) bool: the pixel and its eight neighbours show one surface; the border of the picture never does."""
    low = minimum_filter(surfaces, size=3, mode="constant", cval=-1)
    high = maximum_filter(surfaces, size=3, mode="constant", cval=-1)
    return np.asarray((low == high) & (low >= 0))


def _single_surface_pixels(
    rays: RoomRays,
    groups: NDArray[np.int32],
    normals: NDArray[np.float64],
    camera: CameraModel,
    surfaces: NDArray[np.int32],
    missing: Sight,
) -> NDArray[np.int32]:
    """(H, W) surface numbers of pixels near the missing texels whose own area shows one surface only, else -1."""
    height, width = surfaces.shape
    near = np.zeros(surfaces.shape, dtype=np.bool_)
    nearest = np.rint(missing.pixel).astype(np.int64)
    near[nearest[:, 1], nearest[:, 0]] = True
    near = binary_dilation(near, structure=np.ones((3, 3)), iterations=SNAP_RADIUS) & (surfaces >= 0)
    # Gather kernels read a 2x2 block, so the last row and column cannot be its top-left pixel.
    near[height - 1 :], near[:, width - 1 :] = False, False
    rows, columns = np.nonzero(near)
    usable = np.full(surfaces.shape, -1, dtype=np.int32)
    pure = np.ones(len(rows), dtype=np.bool_)
    own = surfaces[rows, columns]
    for shift_y in _SUBPIXELS:
        for shift_x in _SUBPIXELS:
            left = np.flatnonzero(pure)
            shifted = np.stack([columns[left] + shift_x, rows[left] + shift_y], axis=1)
            pure[left] = pixel_surfaces(rays, groups, normals, camera, shifted) == own[left]
    usable[rows[pure], columns[pure]] = own[pure]
    return usable


def _black_groups(mesh: RoomMesh, groups: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(G,) bool: surfaces that reflect nothing, so that all the light they send is their own."""
    reflects = mesh.material_albedo.max(axis=1)[mesh.face_material] > BLACK_ALBEDO
    return np.asarray(np.bincount(groups, weights=reflects) == 0)


def _pairs_of_tiny_emitters(
    rays: RoomRays,
    groups: NDArray[np.int32],
    normals: NDArray[np.float64],
    camera: CameraModel,
    missing: Sight,
    texel_groups: NDArray[np.int32],
) -> _Pairs:
    """Pairs of black surfaces too small for a pixel of their own: the pixel that they fill best.

    It underestimates them by the share they do not fill, which is better than losing a lamp. Other surfaces are not treated
    so: a thin rim beside a lamp would take on the lamp's radiance.
    """
    parts = [_Pairs(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2), np.float32), np.zeros(0))]
    lens = camera.intrinsics
    around = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(1, 9, 2)
    shifts = np.stack(np.meshgrid(_PIXEL_AREA, _PIXEL_AREA), axis=-1).reshape(1, -1, 2)
    for group in np.unique(texel_groups[missing.texel]):
        mine = texel_groups[missing.texel] == group
        near = np.unique(
            (np.rint(missing.pixel[mine]).astype(np.int64)[:, None] + around).reshape(-1, 2), axis=0
        )
        near = near[((near >= 0) & (near < [lens.width - 1, lens.height - 1])).all(axis=1)]
        surfaces = pixel_surfaces(rays, groups, normals, camera, (near[:, None] + shifts).reshape(-1, 2))
        coverage = (surfaces.reshape(len(near), -1) == group).mean(axis=1)
        if not coverage.any():
            continue
        best = coverage.argmax()
        count = int(mine.sum())
        pixel = np.full(count, near[best, 1] * lens.width + near[best, 0], dtype=np.int64)
        weight = missing.density[mine] * coverage[best]
        parts.append(_Pairs(missing.texel[mine], pixel, np.zeros((count, 2), np.float32), weight))
    return functools.reduce(_joined, parts)


def _select(sight: Sight, wanted: NDArray[np.bool_]) -> Sight:
    keep = wanted[sight.texel]
    return Sight(sight.texel[keep], sight.pixel[keep], sight.density[keep], sight.theta[keep])


def _pairs(
    sight: Sight,
    texel_groups: NDArray[np.int32],
    usable: NDArray[np.int32],
    camera: CameraModel,
    *,
    bilinear: bool,
) -> _Pairs:
    """Validated pairs of one camera; `usable` holds the surface number of pixels that may be used, else -1."""
    pixel, fraction = _validate(sight.pixel, texel_groups[sight.texel], usable, SNAP_RADIUS, bilinear)
    taper = np.cos(np.minimum(sight.theta / camera.intrinsics.theta_max, 1.0) * (np.pi / 2))
    weight = sight.density * np.maximum(taper, 1e-3)
    weight *= np.where(fraction[:, 0] < 0, SNAP_WEIGHT, 1.0)
    keep = pixel >= 0
    return _Pairs(sight.texel[keep], pixel[keep], np.maximum(fraction[keep], 0.0), weight[keep])


def _joined(first: _Pairs, second: _Pairs) -> _Pairs:
    return _Pairs(
        np.concatenate([first.texel, second.texel]),
        np.concatenate([first.pixel, second.pixel]),
        np.concatenate([first.fraction, second.fraction]),
        np.concatenate([first.weight, second.weight]),
    )


@njit(cache=True, nogil=True)
def _validate(points, point_groups, usable, radius, bilinear):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Top-left pixel (-1 = drop) and fractions of each point; fractions of -1 mark a snapped pixel."""
    height, width = usable.shape
    count = points.shape[0]
    pixel = np.full(count, -1, dtype=np.int64)
    fraction = np.full((count, 2), np.float32(-1.0), dtype=np.float32)
    for n in range(count):
        x, y, group = points[n, 0], points[n, 1], point_groups[n]
        column, row = int(np.floor(x)), int(np.floor(y))
        if (
            bilinear
            and usable[row, column] == group
            and usable[row, column + 1] == group
            and usable[row + 1, column] == group
            and usable[row + 1, column + 1] == group
        ):
            pixel[n] = row * width + column
            fraction[n, 0] = x - column
            fraction[n, 1] = y - row
            continue
        best = (radius + 0.5) ** 2
        for i in range(max(0, row - radius), min(height - 1, row + radius + 2)):
            for j in range(max(0, column - radius), min(width - 1, column + radius + 2)):
                if usable[i, j] == group:
                    distance = (i - y) ** 2 + (j - x) ** 2
                    if distance < best:
                        best = distance
                        pixel[n] = i * width + j
    return pixel, fraction


def _assemble(parts: list[_Pairs], num_texels: int, cameras: Sequence[CameraModel]) -> GatherTable:
    """Merge the pairs of all cameras by texel, drop weak ones and normalise the weights."""
    texel = np.concatenate([part.texel for part in parts])
    camera = np.concatenate([np.full(len(part.texel), index, np.uint8) for index, part in enumerate(parts)])
    pixel = np.concatenate([part.pixel for part in parts])
    fraction = np.concatenate([part.fraction for part in parts])
    weight = np.concatenate([part.weight for part in parts])
    best = np.zeros(num_texels)
    np.maximum.at(best, texel, weight)
    # Fading out at the limit instead of cutting there leaves no seam where a camera drops out.
    weight = weight / best[texel] - MIN_RELATIVE_WEIGHT
    keep = np.flatnonzero(weight > 0)
    keep = keep[np.argsort(texel[keep], kind="stable")]
    texel, weight = texel[keep], weight[keep]
    total = np.bincount(texel, weights=weight, minlength=num_texels)
    pair_start = np.zeros(num_texels + 1, dtype=np.int64)
    np.cumsum(np.bincount(texel, minlength=num_texels), out=pair_start[1:])
    return GatherTable(
        pair_start=pair_start,
        camera=camera[keep],
        pixel=pixel[keep].astype(np.uint32),
        fraction_x=np.ascontiguousarray(fraction[keep, 0]),
        fraction_y=np.ascontiguousarray(fraction[keep, 1]),
        weight=(weight / total[texel]).astype(np.float32),
        camera_shapes=tuple((item.intrinsics.height, item.intrinsics.width) for item in cameras),
    )
