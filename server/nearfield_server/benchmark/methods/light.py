"""What every method is given, what it returns, and how the client draws it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.codec import VAL_DTYPE
from nearfield_server.pipeline.sh_projection import project_indirect
from nearfield_server.records import CameraFrame, TexelGeometry

PROBE_RESOLUTION: Final = 64
"""Cube pixels per edge, the same for all methods (Rohmer et al. 2014 use 32)."""
EVERYTHING: Final = np.full(3, np.inf, dtype=np.float32)
"""Threshold that leaves all light to the SH."""

Transfer = Literal["full", "shadowed", "cosine"]
"""full: with self-interreflection and ground shadow; shadowed: Rohmer et al. 2014, Eq. 11; cosine: nothing hides anything."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientForm:
    """How the client draws a method: the transfer of its objects, and the parts of the renderer that it does without.

    Attributes:
        transfer: coefficients of the prepared models.
        indirect_exchange: objects take indirect light from real surfaces and bounce light onto them.
        fixture_rays: rays find what a lamp's own fixture hides.
        room_shadows: the modelled room hides lights.
        receiver_ratio: real surfaces are darkened by shadowed over unshadowed irradiance (Gierlinger et al. 2010).
    """

    transfer: Transfer
    indirect_exchange: bool = False
    fixture_rays: bool = False
    room_shadows: bool = True
    receiver_ratio: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """What stays the same from picture to picture.

    Attributes:
        texels: of the room.
        object_centres: (n, 3) world. object_probes: per object, the texel behind every cube pixel seen from its centre.
        room_centre: (3,) world, middle of the room's box. room_probe: the same from there. room_diagonal: of that box, metres.
    """

    texels: TexelGeometry
    object_centres: NDArray[np.float64]
    object_probes: tuple[NDArray[np.int32], ...]
    room_centre: NDArray[np.float64]
    room_probe: NDArray[np.int32]
    room_diagonal: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AtlasSample:
    """One moment: the camera pictures, and the (N, 3) radiance gathered from them."""

    frames: tuple[CameraFrame, ...]
    radiance: NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodLight:
    """Light of one moment: vals VAL_DTYPE in slot order, object_sh (n, 9, 3) world axes."""

    vals: NDArray[np.void]
    object_sh: NDArray[np.float32]


class Method(Protocol):
    """Extracts light; may keep state from moment to moment."""

    def extract(self, sample: AtlasSample) -> MethodLight:
        """Light of one moment."""
        ...


def make_vals(
    position: NDArray[np.floating],
    normal: NDArray[np.floating],
    radiant_intensity: NDArray[np.floating],
    area: NDArray[np.floating],
) -> NDArray[np.void]:
    """Lights as records: (M, 3) metres, (M, 3) unit, (M, 3) W/sr, (M,) m^2."""
    vals = np.zeros(len(position), dtype=VAL_DTYPE)
    vals["position"], vals["normal"] = position, normal
    vals["radiant_intensity"], vals["area"] = radiant_intensity, area
    return vals


def no_vals() -> NDArray[np.void]:
    """The lights of a method that has none."""
    return np.zeros(0, dtype=VAL_DTYPE)


def object_sh(
    surroundings: Surroundings, radiance: NDArray[np.float32], threshold: NDArray[np.float32]
) -> NDArray[np.float32]:
    """SH of the light below the threshold at every object's centre (Rohmer et al. 2014, Eq. 10): (n, 9, 3)."""
    coeffs = [
        project_indirect(probe, PROBE_RESOLUTION, radiance, threshold) for probe in surroundings.object_probes
    ]
    return np.array(coeffs, np.float32).reshape(-1, 9, 3)
