"""Lamps that no camera sees, found by the light that they throw on surfaces that cameras do see.

A camera in a corner of the ceiling never sees the shining side of a desk lamp. But the atlas tells the reflected radiance
of the desk, the room model its albedo, and the rest of the atlas how much light arrives there from everything visible:
`pi L / albedo = E_visible + sum over hidden surfaces F B`. What is missing on the left side betrays the radiance B of the
hidden surface. Rohmer et al. 2014 name such lost light a limit of their method (section 7).

Albedos of a room model are never exact, so a hidden surface is believed to shine only when it explains a good share of
the light on several receivers, and they agree on its radiance. Belief grows steadily with the evidence: a lamp that is
dimmed among others fades out and never pops, and nothing has to be remembered from update to update.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from nearfield_server.pipeline.hidden_receivers import (
    PROBE_OFFSET,
    RECEIVERS,
    choose_receivers,
    cube_resolution,
    form_factors,
    make_patches,
)
from nearfield_server.pipeline.probes import SightTracer
from nearfield_server.pipeline.receiver_patches import PATCH_TEXELS, find_patches
from nearfield_server.radiometry.cube import cube_directions, cube_solid_angles
from nearfield_server.radiometry.half import HALF_MAX, prefetch
from nearfield_server.records import RoomMesh, TexelGeometry, UnseenFill

_MAX_GROUPS: Final = 160
_MIN_ALBEDO: Final = 0.05
_MIN_FACING: Final = 0.5
"""Length of the mean normal below which a surface is too curved to be one light."""
BELIEF_SHARE: Final = (0.2, 0.4)
"""Share of the light on its receivers that a surface explains: not believed to be a lamp below, wholly above."""
BELIEF_SPREAD: Final = (0.4, 0.3)
"""Median deviation of the radiance according to single receivers, relative to its median: not believed above, wholly below."""
MIN_RECEIVERS: Final = RECEIVERS // 2
_PATCH_REACH: Final = 0.1
"""Radius of the patch around a receiver, relative to the distance of the hidden surface."""
_WELD: Final = 1e-5
_AHEAD: Final = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class HiddenLight:
    """Static data: hidden surfaces, receivers that see them, and what else the receivers see.

    Attributes:
        texels: (H,) positions of the texels of hidden surfaces. group: (H,) surface of each, 0 to G - 1.
        receiver: (R, K) seen texels around each receiver, which shows their mean; grouped by the hidden surface that it was
            chosen for.
        group_rows: (G + 1,) receivers of surface g are rows `group_rows[g]:group_rows[g + 1]`.
        inverse_albedo: (R, 3) pi / albedo of the receivers.
        form_factor: (R, G) irradiance on a receiver per unit radiance of a hidden surface.
        ray_start: (R + 1,), ray_texel: (rays,) and ray_weight: (rays,): what receivers see of the visible room, each texel once per
            receiver, with the projected solid angle of its rays.
    """

    texels: NDArray[np.int32]
    group: NDArray[np.int32]
    receiver: NDArray[np.int32]
    group_rows: NDArray[np.int64]
    inverse_albedo: NDArray[np.float64]
    form_factor: NDArray[np.float64]
    ray_start: NDArray[np.int64]
    ray_texel: NDArray[np.int32]
    ray_weight: NDArray[np.float32]

    @property
    def num_groups(self) -> int:
        """G."""
        return int(self.form_factor.shape[1])


def no_hidden_light() -> HiddenLight:
    """A record without surfaces, receivers and rays."""
    none = np.zeros(0, dtype=np.int32)
    return HiddenLight(
        texels=none,
        group=none,
        receiver=none.reshape(0, PATCH_TEXELS),
        group_rows=np.zeros(1, dtype=np.int64),
        inverse_albedo=np.zeros((0, 3)),
        form_factor=np.zeros((0, 0)),
        ray_start=np.zeros(1, dtype=np.int64),
        ray_texel=none,
        ray_weight=np.zeros(0, dtype=np.float32),
    )


def texels_without_source(fill: UnseenFill, num_texels: int) -> NDArray[np.bool_]:
    """(N,) texels that no camera sees and that have nothing to repeat: where hidden lamps are searched for."""
    unseen = np.zeros(num_texels, dtype=np.bool_)
    unseen[fill.texel[fill.source < 0]] = True
    return unseen


def find_hidden_light(
    mesh: RoomMesh, texels: TexelGeometry, unseen: NDArray[np.bool_], probe_rays: SightTracer
) -> HiddenLight | None:
    """Collect the surfaces that no camera sees and the receivers that would betray them.

    Args:
        mesh: room, with albedos.
        texels: its texels.
        unseen: (N,) texels of surfaces of which no camera sees any part.
        probe_rays: ray tracer of the room.

    Returns:
        The static data, or None where there is nothing to find.
    """
    hidden, group = _hidden_surfaces(mesh, texels, unseen)
    if hidden.size == 0:
        return None
    albedo = mesh.material_albedo[mesh.face_material[texels.face]]
    usable = ~unseen & (albedo.min(axis=1) >= _MIN_ALBEDO)
    num_groups = int(group.max()) + 1
    resolution = cube_resolution(num_groups * RECEIVERS)
    directions, solid_angles = cube_directions(resolution), cube_solid_angles(resolution)
    hidden_group = np.full(unseen.size, -1, dtype=np.int64)
    hidden_group[hidden] = group
    patches = make_patches(texels, hidden, group, num_groups)
    receivers: list[int] = []
    owners: list[int] = []
    factors: list[NDArray[np.float64]] = []
    reach: list[float] = []
    rays: list[tuple[NDArray[np.int32], NDArray[np.float32]]] = []
    for surface in range(num_groups):
        members = hidden[group == surface]
        centre = texels.position[members].mean(axis=0, dtype=np.float64)
        for receiver in choose_receivers(texels, members, usable, probe_rays):
            position = texels.position[receiver].astype(np.float64)
            normal = texels.normal[receiver].astype(np.float64)
            weight = np.maximum(directions @ normal, 0.0) * solid_angles
            seen = probe_rays.trace(position + PROBE_OFFSET * normal, resolution)
            lit = (weight > 0.0) & (seen >= 0)
            row = form_factors(texels, patches, surface, position, normal, probe_rays)
            visible = lit & (hidden_group[seen] < 0)
            receivers.append(receiver)
            owners.append(surface)
            factors.append(row)
            reach.append(_PATCH_REACH * float(np.linalg.norm(centre - position)))
            rays.append(_merge_rays(seen[visible], weight[visible]))
    if not receivers:
        return None
    chosen = np.array(receivers, dtype=np.int32)
    return HiddenLight(
        texels=hidden,
        group=group,
        receiver=find_patches(mesh, texels, usable, chosen, np.array(reach)),
        group_rows=np.searchsorted(owners, np.arange(num_groups + 1)),
        inverse_albedo=np.pi / albedo[chosen],
        form_factor=np.stack(factors),
        ray_start=np.concatenate([[0], np.cumsum([texel.size for texel, _ in rays])]).astype(np.int64),
        ray_texel=np.concatenate([texel for texel, _ in rays]),
        ray_weight=np.concatenate([weight for _, weight in rays]),
    )


def _merge_rays(
    texel: NDArray[np.int32], weight: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Rays (n,) to texels as one per texel, in texel order: an update reads each texel once per receiver."""
    merged, ray = np.unique(texel, return_inverse=True)
    return merged.astype(np.int32), np.bincount(ray, weight, merged.size).astype(np.float32)


def _hidden_surfaces(
    mesh: RoomMesh, texels: TexelGeometry, unseen: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Texels of hidden connected surfaces of one material that face one way, and their numbers; the largest first."""
    hidden = np.flatnonzero(unseen & (texels.area > 0.0))
    if hidden.size == 0:
        return hidden.astype(np.int32), hidden.astype(np.int32)
    faces = np.unique(texels.face[hidden])
    _, welded = np.unique(np.rint(mesh.positions / _WELD).astype(np.int64), axis=0, return_inverse=True)
    num_points = int(welded.max()) + 1
    # One node per (corner, material): faces of different materials do not join.
    corner = (
        welded.reshape(-1)[mesh.faces[faces]] + mesh.face_material[faces, None].astype(np.int64) * num_points
    )
    nodes, corner_node = np.unique(corner, return_inverse=True)
    corner_node = corner_node.reshape(-1, 3)
    ends = (corner_node[:, [0, 1]].reshape(-1), corner_node[:, [1, 2]].reshape(-1))
    graph = coo_array((np.ones(ends[0].size, dtype=np.int8), ends), shape=(nodes.size, nodes.size))
    _, component = connected_components(graph, directed=False)
    group = component[corner_node[np.searchsorted(faces, texels.face[hidden]), 0]]
    area = texels.area[hidden].astype(np.float64)
    total = np.bincount(group, weights=area)
    mean = np.stack(
        [np.bincount(group, weights=area * texels.normal[hidden, axis]) for axis in range(3)], axis=1
    )
    facing = np.linalg.norm(mean, axis=1) / np.maximum(total, 1e-30)
    order = np.argsort(-np.where(facing >= _MIN_FACING, total, 0.0))[:_MAX_GROUPS]
    order = order[facing[order] >= _MIN_FACING]
    number = np.full(total.size, -1, dtype=np.int32)
    number[order] = np.arange(order.size, dtype=np.int32)
    kept = number[group] >= 0
    return hidden[kept].astype(np.int32), number[group][kept]


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _visible_irradiance(ray_start: Any, ray_texel: Any, ray_weight: Any, radiance: Any, out: Any) -> None:
    address, num_rays = radiance.ctypes.data, ray_texel.shape[0]
    for receiver in range(out.shape[0]):
        red, green, blue = 0.0, 0.0, 0.0
        for ray in range(ray_start[receiver], ray_start[receiver + 1]):
            # Texels lie anywhere in memory: ask for them early.
            ahead = ray_texel[min(ray + _AHEAD, num_rays - 1)]
            prefetch(address + np.int64(ahead) * radiance.strides[0])
            texel = ray_texel[ray]
            weight = np.float64(ray_weight[ray])
            red += weight * radiance[texel, 0]
            green += weight * radiance[texel, 1]
            blue += weight * radiance[texel, 2]
        out[receiver, 0], out[receiver, 1], out[receiver, 2] = red, green, blue


def estimate_hidden_radiance(hidden: HiddenLight, radiance: NDArray[np.float32]) -> NDArray[np.float64]:
    """Radiance of every hidden surface from the atlas; 0 where the evidence is too weak.

    Args:
        hidden: static data.
        radiance: (N, 3) gathered radiance.

    Returns:
        (G, 3) float64 >= 0; continuous in the atlas as long as surfaces keep their order of radiance.
    """
    visible = np.empty((hidden.receiver.shape[0], 3))
    _visible_irradiance(hidden.ray_start, hidden.ray_texel, hidden.ray_weight, radiance, visible)
    shown = radiance[hidden.receiver].mean(axis=1, dtype=np.float64)
    return explain_receivers(hidden, shown, visible)


def explain_receivers(
    hidden: HiddenLight,
    receiver_radiance: NDArray[np.floating[Any]],
    visible_irradiance: NDArray[np.floating[Any]],
) -> NDArray[np.float64]:
    """The part of `estimate_hidden_radiance` that needs no atlas, only what the receivers show.

    Args:
        hidden: static data.
        receiver_radiance: (R, 3) mean gathered radiance of each receiver's texels.
        visible_irradiance: (R, 3) irradiance on them from everything visible.

    Returns:
        (G, 3) float64 >= 0.
    """
    measured = np.asarray(receiver_radiance, dtype=np.float64) * hidden.inverse_albedo
    explained = _explain(hidden.form_factor, hidden.group_rows, measured, measured - visible_irradiance)
    # More than a camera can deliver is no lamp, and sums of energy rely on that bound.
    return np.asarray(np.minimum(explained, HALF_MAX))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _belief(share: float, spread: float) -> float:
    """0 to 1, linear between the limits."""
    explained = (share - BELIEF_SHARE[0]) / (BELIEF_SHARE[1] - BELIEF_SHARE[0])
    agreed = (spread - BELIEF_SPREAD[0]) / (BELIEF_SPREAD[1] - BELIEF_SPREAD[0])
    return min(max(explained, 0.0), 1.0) * min(max(agreed, 0.0), 1.0)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _evidence(
    factors: Any, surface: int, first: int, last: int, measured: Any, missing: Any, radiance: Any
) -> None:
    """Write the believed `radiance` (3,) of a surface: what its receivers miss, as far as the evidence goes."""
    count = last - first
    samples = np.empty((3, count))
    grey = np.empty(count)
    arriving = np.empty(count)
    used = 0
    for row in range(first, last):
        factor = factors[row, surface]
        received = measured[row, 0] + measured[row, 1] + measured[row, 2]
        if factor > 0.0 and received > 0.0:
            for channel in range(3):
                samples[channel, used] = missing[row, channel] / factor
            grey[used] = (missing[row, 0] + missing[row, 1] + missing[row, 2]) / factor
            arriving[used] = factor / received
            used += 1
    radiance[:] = 0.0
    if used < MIN_RECEIVERS:
        return
    for channel in range(3):
        radiance[channel] = max(np.median(samples[channel, :used]), 0.0)
    total = radiance[0] + radiance[1] + radiance[2]
    if total > 0.0:
        spread = np.median(np.abs(grey[:used] - np.median(grey[:used]))) / total
        radiance *= _belief(np.median(arriving[:used]) * total, spread)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _explain(factors: Any, group_rows: Any, measured: Any, missing: Any) -> Any:
    """Let surfaces explain the missing light one after the other, the brightest first.

    Lamps are small and bright, and what surrounds a lamp only repeats its light.
    """
    num_groups = factors.shape[1]
    result = np.zeros((num_groups, 3))
    found = np.zeros((num_groups, 3))
    is_open = np.ones(num_groups, dtype=np.bool_)
    stale = np.ones(num_groups, dtype=np.bool_)
    for _ in range(num_groups):
        best = -1
        for surface in range(num_groups):
            if not is_open[surface]:
                continue
            first, last = group_rows[surface], group_rows[surface + 1]
            if stale[surface]:
                _evidence(factors, surface, first, last, measured, missing, found[surface])
                stale[surface] = False
            believed = found[surface].sum()
            if believed > 0.0 and (best < 0 or believed > found[best].sum()):
                best = surface
        if best < 0:
            break
        result[best] = found[best]
        is_open[best] = False
        for surface in range(num_groups):
            for row in range(group_rows[surface], group_rows[surface + 1]):
                if factors[row, best] > 0.0:
                    stale[surface] = True
                    for channel in range(3):
                        missing[row, channel] -= factors[row, best] * found[best, channel]
    return result
