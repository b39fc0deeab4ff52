"""Receivers: seen surfaces that would betray a hidden lamp, and how much of its light each would get."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.pipeline.probes import SightTracer
from nearfield_server.radiometry.cube import cube_directions
from nearfield_server.records import TexelGeometry

_CHOICE_RESOLUTION: Final = 24
"""Cube pixels per edge among which receivers are chosen: coarse, so that they lie apart and do not share the error of one spot."""
_MIN_RESOLUTION: Final = 24
_MAX_RESOLUTION: Final = 96
"""Cube pixels per edge from a receiver: as many as `_RAY_BUDGET` allows. What small lamps in sight send to a receiver is wrong by as
much as their image on the cube is, and what is not explained by them is held for light of a hidden one."""
_RAY_BUDGET: Final = 1 << 18
RECEIVERS: Final = 7
_SOURCE_TEXELS: Final = 32
_MIN_COSINE: Final = 0.1
_FRONTAL_POWER: Final = 4
_MIN_DISTANCE: Final = 2.0
"""Nearest receiver where there is a choice, in units of the hidden surface's size (square root of its area)."""
PROBE_OFFSET: Final = 2e-3
"""Metres by which probes are lifted off their surface."""


def choose_receivers(
    texels: TexelGeometry,
    members: NDArray[np.int32],
    usable: NDArray[np.bool_],
    probe_rays: SightTracer,
) -> NDArray[np.int64]:
    """Seen texels in front of a hidden surface, among those on which it would shine most: (n <= RECEIVERS,).

    Args:
        texels: of the room.
        members: texels of the hidden surface.
        usable: (N,) texels that cameras see and that reflect enough.
        probe_rays: ray tracer of the room.
    """
    position = texels.position[members].astype(np.float64)
    centre = position.mean(axis=0)
    middle = members[np.argmin(np.sum((position - centre) ** 2, axis=1))]
    normal = texels.normal[middle].astype(np.float64)
    origin = texels.position[middle].astype(np.float64) + PROBE_OFFSET * normal
    seen = probe_rays.trace(origin, _CHOICE_RESOLUTION)
    candidates = np.unique(seen[(seen >= 0) & (cube_directions(_CHOICE_RESOLUTION) @ normal > _MIN_COSINE)])
    candidates = candidates[usable[candidates]]
    if candidates.size == 0:
        return np.asarray(candidates, dtype=np.int64)
    offset = texels.position[candidates].astype(np.float64) - origin
    squared = np.maximum(np.einsum("ni,ni->n", offset, offset), 1e-6)
    incoming = -np.einsum("ni,ni->n", offset, texels.normal[candidates].astype(np.float64)) / np.sqrt(squared)
    facing = (offset @ normal) / np.sqrt(squared)
    # Shades and frames hide a lamp from the side: receivers in front of it tell more than those that only glimpse it.
    strength = facing**_FRONTAL_POWER * np.maximum(incoming, 0.0) / squared
    strength[incoming < _MIN_COSINE] = 0.0
    # The inside of a fixture is too close: cameras glimpse only its rim, and its own reflections outshine the model.
    # A large surface (a whole ceiling) has no others.
    far = squared >= _MIN_DISTANCE**2 * texels.area[members].sum(dtype=np.float64)
    if np.count_nonzero(strength[far]) >= RECEIVERS:
        strength[~far] = 0.0
    order = np.argsort(-strength)[: 4 * RECEIVERS]
    order = order[strength[order] > 0.0]
    return np.asarray(candidates[order[:: max(1, order.size // RECEIVERS)][:RECEIVERS]], dtype=np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Patches:
    """Some texels of every hidden surface that stand for it: texel, surface and area (m^2) of each, (n,)."""

    texel: NDArray[np.int32]
    group: NDArray[np.int32]
    area: NDArray[np.float64]


def make_patches(
    texels: TexelGeometry, hidden: NDArray[np.int32], group: NDArray[np.int32], num_groups: int
) -> Patches:
    """Choose the patches.

    Args:
        texels: of the room.
        hidden: (H,) texels of all hidden surfaces.
        group: (H,) surface of each.
        num_groups: G.
    """
    texel, number, area = [], [], []
    for surface in range(num_groups):
        members = hidden[group == surface]
        chosen = members[:: max(1, members.size // _SOURCE_TEXELS)]
        texel.append(chosen)
        number.append(np.full(chosen.size, surface, dtype=np.int32))
        total = float(texels.area[members].sum(dtype=np.float64))
        area.append(np.full(chosen.size, total / chosen.size))
    return Patches(texel=np.concatenate(texel), group=np.concatenate(number), area=np.concatenate(area))


def form_factors(
    texels: TexelGeometry,
    patches: Patches,
    owner: int,
    position: NDArray[np.float64],
    normal: NDArray[np.float64],
    probe_rays: SightTracer,
) -> NDArray[np.float64]:
    """(G,) irradiance per unit radiance of every hidden surface, its patches as discs.

    The receiver was chosen in full sight of its owner; of the others only the patches in sight count. They are tested one by
    one: a thin lamp falls between the pixels of a cube.

    Args:
        texels: of the room.
        patches: of all hidden surfaces.
        owner: surface that the receiver was chosen for.
        position: (3,) of the receiver.
        normal: (3,) of the receiver.
        probe_rays: ray tracer of the room.
    """
    offset = texels.position[patches.texel].astype(np.float64) - position
    squared = np.einsum("ni,ni->n", offset, offset)
    cosines = np.maximum(offset @ normal, 0.0) * np.maximum(
        -np.einsum("ni,ni->n", offset, texels.normal[patches.texel].astype(np.float64)), 0.0
    )
    factor = cosines * patches.area / np.maximum(squared * (squared + patches.area / np.pi), 1e-30)
    asked = np.flatnonzero((factor > 0.0) & (patches.group != owner))
    targets = texels.position[patches.texel[asked]] + PROBE_OFFSET * texels.normal[patches.texel[asked]]
    seen = probe_rays.sees(position + PROBE_OFFSET * normal, targets.astype(np.float64))
    factor[asked[~seen]] = 0.0
    return np.asarray(np.bincount(patches.group, weights=factor), dtype=np.float64)


def cube_resolution(num_receivers: int) -> int:
    """Pixels per edge of the cubes of this many receivers; half of a cube's 6 R^2 pixels lie above the surface."""
    fitting = int(np.sqrt(_RAY_BUDGET / (3.0 * num_receivers)))
    return min(max(fitting, _MIN_RESOLUTION), _MAX_RESOLUTION)
