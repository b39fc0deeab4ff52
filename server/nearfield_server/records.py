"""Frozen data that crosses module borders inside the server.

Arrays are C-contiguous and are not written to after construction. Frames, units and index rules: protocol/CONVENTIONS.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_calibration.models import FisheyeIntrinsics, PinholeIntrinsics


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomMesh:
    """The reconstructed room, ready for the atlas.

    Attributes:
        positions: (V, 3) float64, world frame, metres.
        normals: (V, 3) float64, unit, world frame.
        uv: (V, 2) float64 in [0, 1], glTF convention, charts do not overlap.
        faces: (F, 3) int32, counter-clockwise seen from the front; no zero-area face (in space or in UV).
        face_material: (F,) int32, index into `materials`.
        materials: names, one per glTF primitive or material.
        material_albedo: (K, 3) float64 linear diffuse albedo.
        uv_source: "file" when the UVs are those of the GLB, "xatlas" when they had to be made.
        content_hash: hex digest of geometry, UVs and albedo; the key of everything derived from the mesh.
    """

    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64]
    faces: NDArray[np.int32]
    face_material: NDArray[np.int32]
    materials: tuple[str, ...]
    material_albedo: NDArray[np.float64]
    uv_source: str
    content_hash: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TexelGeometry:
    """One record per covered atlas texel, in a fixed order that all per-texel arrays share.

    Attributes:
        height: atlas rows. width: atlas columns.
        texel_index: (N,) int32, flat index `row * width + column`, unique.
        position: (N, 3) float32, world frame, metres.
        normal: (N, 3) float32, unit, world frame.
        area: (N,) float32, m^2 of world surface that the texel stands for; the sum over a triangle is the triangle's area (and that of
            neighbours too small to own a texel).
        face: (N,) int32, triangle of the room mesh.
        lookup: (height, width) int32, position in this order, or -1 where no texel is covered.
        gutter_texel: (G,) int32 flat indices of uncovered texels within two texels of a chart (dilation, zero area).
        gutter_source: (G,) int32 positions (in this order) whose radiance each gutter texel repeats.
    """

    height: int
    width: int
    texel_index: NDArray[np.int32]
    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    area: NDArray[np.float32]
    face: NDArray[np.int32]
    lookup: NDArray[np.int32]
    gutter_texel: NDArray[np.int32]
    gutter_source: NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True)
class GatherTable:
    """Which pixels of which cameras show each texel: exact visibility, validated taps, blending weights.

    Pairs are grouped by texel: the pairs of texel n are `pair_start[n]:pair_start[n + 1]`. The weights of the pairs of a texel sum to 1
    (to float32 rounding of the packed weights); a texel without pairs is seen by no camera and keeps radiance 0.
    The radiance of a pair is the bilinear blend of the 2x2 pixels whose top-left one is `pixel`, with fractions `fraction_x/y`;
    both fractions are 0 where the neighbourhood shows more than one surface (one valid pixel is used as it is).

    Attributes:
        pair_start: (N + 1,) int64.
        camera: (P,) uint8, index of the camera.
        pixel: (P,) uint32, flat index of the top-left tap, `row * width + column` in that camera.
        fraction_x: (P,) float32 in [0, 1]. fraction_y: (P,) float32 in [0, 1].
        weight: (P,) float32 > 0.
        camera_shapes: ((height, width), ...) per camera.
    """

    pair_start: NDArray[np.int64]
    camera: NDArray[np.uint8]
    pixel: NDArray[np.uint32]
    fraction_x: NDArray[np.float32]
    fraction_y: NDArray[np.float32]
    weight: NDArray[np.float32]
    camera_shapes: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class UnseenFill:
    """What to put where no camera looks: unseen texels may repeat a seen texel.

    Attributes:
        texel: (M,) int32 positions (texel order) of all texels without pairs in the gather table.
        source: (M,) int32 position of the seen texel to repeat: the nearest of the same surface, else the most alike; -1
            where there is none (unseen black surfaces, which include unseen lamps), so that the radiance stays 0.
    """

    texel: NDArray[np.int32]
    source: NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """A calibrated fish-eye camera: identifier, lens and pose."""

    camera_id: str
    intrinsics: FisheyeIntrinsics
    world_from_camera: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class TabletView:
    """A fixed tablet view: identifier, lens, pose and its background files (one basis picture per switchable light)."""

    view_id: str
    intrinsics: PinholeIntrinsics
    world_from_camera: NDArray[np.float64]
    background_files: tuple[str, ...] = ()


FRAME_TILE: Final = 32
"""Side of a tile of a camera picture, pixels: the unit in which changes of a picture are told."""
VALID_BITS: Final = 0x3C00
"""Alpha of a pixel that is measured, as the bits of a half float: 1."""
LOWER_BOUND_BITS: Final = 0x3BFF
"""Alpha of a pixel of which the radiance is only a lower bound: the largest half below 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraFrame:
    """One linear HDR picture of one camera, already clean (finite, 0 <= value <= 65504).

    Attributes:
        camera_index: position of the camera in the room file.
        sequence: counts up by one per captured frame.
        content_revision: equal for two frames of one camera only if their pixels are equal; lets stages be skipped.
        timestamp_ns: capture time, CLOCK_MONOTONIC of the capturing host.
        pixels: (H, W, 4) float16 relative or absolute radiance; alpha 1 = valid, 0 = invalid or outside the image circle, the
            largest half below 1 = valid as a lower bound.
        tile_revisions: (ceil(H / FRAME_TILE), ceil(W / FRAME_TILE)) int64; equal for two frames of one camera only if the pixels of
            that tile are equal. None: any pixel may differ.
    """

    camera_index: int
    sequence: int
    content_revision: int
    timestamp_ns: int
    pixels: NDArray[np.float16]
    tile_revisions: NDArray[np.int64] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectPlacement:
    """Where an object stands: `revision` changes whenever `world_from_object` (4, 4) float64 does."""

    revision: int
    world_from_object: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectPose:
    """Where a virtual object stands.

    Attributes:
        object_index: position of the object in the room file.
        revision: changes whenever the pose does.
        world_from_object: (4, 4) float64, rotation and translation only.
        centre_object: (3,) float64, centre of the model's bounding sphere in object axes; the SH are taken there.
        radius: of that bounding sphere, metres.
    """

    object_index: int
    revision: int
    world_from_object: NDArray[np.float64]
    centre_object: NDArray[np.float64]
    radius: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LightSettings:
    """How light is extracted.

    Attributes:
        num_vals: 8 to 64.
        split_ratio: share of sum L dA per channel that becomes direct light, in (0, 1]; None chooses the threshold from the atlas.
        num_samples: importance samples for the clustering.
        kmeans_iterations: upper bound of iterations per update.
        seed: of the sampling pattern.
    """

    num_vals: int = 16
    split_ratio: float | None = None
    num_samples: int = 4096
    kmeans_iterations: int = 20
    seed: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class StageReport:
    """What one stage did in one update.

    Attributes:
        name: of the stage.
        ran: False where it was skipped.
        reason: why it ran or was skipped, in words.
        wall_ms: time it took, 0 when skipped. cpu_ms: the same of all threads.
        part: share of the stage's whole work that was done, in [0, 1]: 0 skipped, 1 everything, between them only what had changed.
        saved_ms: CPU time that skipping saved, estimated from the mean of this stage's whole runs after the first; 0 until there was one.
        error_bound: largest relative error of the result that skipping can have caused; 0 where the result is bit for bit the same.
    """

    name: str
    ran: bool
    reason: str
    wall_ms: float
    cpu_ms: float
    part: float = 1.0
    saved_ms: float = 0.0
    error_bound: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LightUpdate:
    """The result of one pass of the pipeline.

    Attributes:
        revision: counts up whenever `vals` or `object_sh` changed; equal revision means an identical packet.
        timestamp_ns: capture time of the oldest camera frame that took part.
        vals: (num_vals,) nearfield_protocol.codec.VAL_DTYPE, slot order.
        object_sh: (num_objects, 9, 3) float32 sh_coeffs, world axes, W/m^2 (radiance x sr).
        threshold: (3,) float32, radiance at and above which a texel's channel is direct.
        stages: what ran.
        counters: numbers for the status page (clamped pixels, unseen texels, used VALs, ...).
    """

    revision: int
    timestamp_ns: int
    vals: NDArray[np.void]
    object_sh: NDArray[np.float32]
    threshold: NDArray[np.float32]
    stages: tuple[StageReport, ...]
    counters: dict[str, float] = field(default_factory=dict)
