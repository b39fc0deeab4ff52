"""What `GET /api/scene` returns: everything that a client needs to know once, before light packets arrive.

The field names are those of the JSON. Units, frames and index rules:
protocol/CONVENTIONS.md. URLs are relative to the page (`assets/room.glb`), so that the service also works
below a path of a reverse proxy.
"""

from __future__ import annotations

import math
import re
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1)]
Vector3 = tuple[Finite, Finite, Finite]
Rgb = tuple[NonNegative, NonNegative, NonNegative]
Matrix4 = Annotated[tuple[Finite, ...], Field(min_length=16, max_length=16)]
"""Row-major 4x4 for column vectors: element (row r, column c) is [4 r + c]; the last row is 0 0 0 1."""

ASSET_URL = re.compile(r"assets/(?:[A-Za-z0-9][A-Za-z0-9._-]{0,63}/){0,2}[A-Za-z0-9][A-Za-z0-9._-]{0,63}\Z")


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


def _checked_asset_url(url: str) -> str:
    if not ASSET_URL.match(url) or ".." in url:
        raise ValueError(f"expected a relative URL such as 'assets/objects/bunny.glb', found {url!r}")
    return url


class Bounds(_Record):
    """Axis-aligned box in world coordinates, metres: it spans `minimum` to `minimum + size`."""

    minimum: Vector3
    size: tuple[Positive, Positive, Positive]


class AtlasDescription(_Record):
    """The radiance atlas of the room model.

    Attributes:
        width: texels. height: texels; row 0 is v = 0.
        texels: number of covered texels.
        stream_width: width of the streamed picture (atlas tiles), texels. stream_height: its height.
        tile_size: edge of one streamed square tile, texels.
    """

    width: Count
    height: Count
    texels: Annotated[int, Field(ge=0)]
    stream_width: Count = 256
    stream_height: Count = 256
    tile_size: Literal[32] = 32

    @model_validator(mode="after")
    def _whole_tiles(self) -> AtlasDescription:
        if self.stream_width % self.tile_size or self.stream_height % self.tile_size:
            raise ValueError(
                f"the streamed atlas must be whole tiles of {self.tile_size} texels, "
                f"found {self.stream_width} x {self.stream_height}"
            )
        return self


class RoomDescription(_Record):
    """The reconstructed room.

    Attributes:
        name: of the room file.
        model_url: GLB with the geometry and the atlas UVs (TEXCOORD_0).
        revision: number that light packets repeat as `room_revision`; a packet with another number
            belongs to another model.
        atlas: the radiance atlas.
        bounds: box around the room model.
    """

    name: str
    model_url: str
    revision: Annotated[int, Field(ge=0, le=0xFFFFFFFF)]
    atlas: AtlasDescription
    bounds: Bounds

    _url = field_validator("model_url")(_checked_asset_url)


class ObjectDescription(_Record):
    """A virtual object.

    Attributes:
        index: position in `objects` and in the light packet.
        name: shown to users.
        model_url: prepared GLB (transfer coefficients, shadow proxy).
        albedo: linear diffuse albedo that replaces the one of the model.
        world_from_object: initial pose, row-major.
        pose_revision: of that pose; control state and light packets repeat it.
    """

    index: Annotated[int, Field(ge=0)]
    name: str
    model_url: str
    albedo: tuple[
        Annotated[float, Field(ge=0, le=1)],
        Annotated[float, Field(ge=0, le=1)],
        Annotated[float, Field(ge=0, le=1)],
    ]
    world_from_object: Matrix4
    pose_revision: Annotated[int, Field(ge=0, le=0xFFFFFFFF)] = 0

    _url = field_validator("model_url")(_checked_asset_url)


class ViewDescription(_Record):
    """A fixed tablet view with its ideal pinhole lens.

    Attributes:
        index: position in `views`.
        id: from the room file.
        width: pixels. height: pixels. fx, fy: focal lengths, pixels.
        cx, cy: principal point, pixels (centres are integers).
        world_from_camera: OpenCV camera axes, row-major.
        background_urls: linear OpenEXR pictures of the empty room, one per entry of `lights`, in that order;
            picture k shows white light k at `basis_radiance` alone:
            `background = sum_k weight_k * radiance_k / basis_radiance_k * picture_k`.
            Empty when the view has no pictures (the client then draws the room from the streamed atlas).
    """

    index: Annotated[int, Field(ge=0)]
    id: str
    width: Count
    height: Count
    fx: Positive
    fy: Positive
    cx: Finite
    cy: Finite
    world_from_camera: Matrix4
    background_urls: tuple[str, ...] = ()

    @field_validator("background_urls")
    @classmethod
    def _urls(cls, urls: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(_checked_asset_url(url) for url in urls)


class LightDescription(_Record):
    """A lamp that the source can switch (virtual-lab rooms); a room with real cameras has none.

    Attributes:
        index: position in `lights`; light weights on the wire use it.
        name: shown to users.
        radiance: of the lamp at weight 1, W/(sr m^2).
        basis_radiance: of the white lamp in the basis pictures, W/(sr m^2).
        weight: initial weight.
    """

    index: Annotated[int, Field(ge=0)]
    name: str
    radiance: Rgb
    basis_radiance: Positive
    weight: NonNegative = 1.0


class SettingsDescription(_Record):
    """How light is extracted and shown.

    Attributes:
        num_vals: slots per light packet.
        light_encoding: "compact" or "plain", what the server sends unless a client asks for the other.
        exposure: factor on linear radiance before the sRGB transfer function; null = the client brings the
            98th percentile of the luminance of its first background to 0.9.
        stale_after_ms: light older than this is shown as stale.
    """

    num_vals: Annotated[int, Field(ge=0, le=64)] = 16
    light_encoding: Literal["compact", "plain"] = "compact"
    exposure: Positive | None = None
    stale_after_ms: Positive = 1000.0


class SceneDescription(_Record):
    """The JSON of `GET /api/scene`."""

    protocol_version: Annotated[int, Field(ge=1)]
    room: RoomDescription
    objects: tuple[ObjectDescription, ...] = ()
    views: tuple[ViewDescription, ...] = ()
    lights: tuple[LightDescription, ...] = ()
    settings: SettingsDescription = SettingsDescription()

    @model_validator(mode="after")
    def _consistent(self) -> SceneDescription:
        for name, entries in (("objects", self.objects), ("views", self.views), ("lights", self.lights)):
            found = [entry.index for entry in entries]
            if found != list(range(len(entries))):
                raise ValueError(f"{name}: expected indices 0 to {len(entries) - 1} in order, found {found}")
        for view in self.views:
            if view.background_urls and len(view.background_urls) != max(1, len(self.lights)):
                raise ValueError(
                    f"views[{view.index}].background_urls: expected one picture per light "
                    f"({max(1, len(self.lights))}), found {len(view.background_urls)}"
                )
        for where, matrix in [
            *((f"objects[{o.index}].world_from_object", o.world_from_object) for o in self.objects),
            *((f"views[{v.index}].world_from_camera", v.world_from_camera) for v in self.views),
        ]:
            check_rigid(matrix, where)
        return self


def check_rigid(matrix: tuple[float, ...], where: str) -> None:
    """Refuse a row-major 4x4 that is not a rotation and a translation (tolerance 1e-3 per scalar product).

    Raises:
        ValueError: names `where`, what was expected and what was found.
    """
    if matrix[12:] != (0.0, 0.0, 0.0, 1.0):
        raise ValueError(f"{where}: expected a last row of 0 0 0 1, found {matrix[12:]}")
    columns = [[matrix[4 * row + column] for row in range(3)] for column in range(3)]
    for i in range(3):
        for j in range(i, 3):
            product = math.fsum(a * b for a, b in zip(columns[i], columns[j], strict=True))
            if abs(product - (i == j)) > 1e-3:
                raise ValueError(
                    f"{where}: expected orthonormal axes without scale, "
                    f"found axis {i} . axis {j} = {product:.6g}"
                )
    a, b, c = columns
    determinant = (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    if determinant < 0:
        raise ValueError(f"{where}: expected a right-handed frame, found determinant {determinant:.6g}")
