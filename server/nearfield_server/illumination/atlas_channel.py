"""The room's radiance atlas, small enough to stream: averaged down, dilated, and cut into the tiles that changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from nearfield_protocol.codec import AtlasTiles, cut_tiles, encode_radiance, tile_changes
from nearfield_server.records import TexelGeometry

STREAM_SIZE = 512
_GUTTER = 2.9  # cells: two rings around every chart, corners included


@dataclass(frozen=True, slots=True, kw_only=True)
class AtlasDownsampler:
    """Where every texel of the atlas goes in the streamed one; built once per room.

    Attributes:
        size: edge of the streamed atlas, cells.
        cell: (N,) int64, flat cell of each texel, in texel order.
        area: (N,) float64, m^2.
        inverse_area: (size * size,) float64, 1 / covered area of each cell, 0 where nothing is covered.
        gutter_cell: (G,) int64, uncovered cells beside a chart. gutter_source: (G,) int64, the nearest covered cell of each.
    """

    size: int
    cell: NDArray[np.int64]
    area: NDArray[np.float64]
    inverse_area: NDArray[np.float64]
    gutter_cell: NDArray[np.int64]
    gutter_source: NDArray[np.int64]


def build_downsampler(texels: TexelGeometry, size: int = STREAM_SIZE) -> AtlasDownsampler:
    """Prepare averaging an atlas down to `size` x `size` cells over the same UV square."""
    row, column = np.divmod(texels.texel_index.astype(np.int64), texels.width)
    cell = (row * size // texels.height) * size + column * size // texels.width
    area = texels.area.astype(np.float64)
    total = np.bincount(cell, weights=area, minlength=size * size)
    covered = total > 0
    inverse_area = np.divide(1.0, total, out=np.zeros_like(total), where=covered)
    empty = np.zeros(0, np.int64)
    gutter_cell, gutter_source = empty, empty
    if covered.any():
        distance, nearest = distance_transform_edt(~covered.reshape(size, size), return_indices=True)
        gutter_cell = np.flatnonzero((distance > 0) & (distance < _GUTTER))
        gutter_source = np.ravel_multi_index(tuple(nearest.reshape(2, -1)[:, gutter_cell]), (size, size))
    return AtlasDownsampler(
        size=size,
        cell=cell,
        area=area,
        inverse_area=inverse_area,
        gutter_cell=gutter_cell,
        gutter_source=gutter_source.astype(np.int64),
    )


def downsample_atlas(sampler: AtlasDownsampler, radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    """Average radiance over each cell, weighted with area, so that the sum of radiance times area stays what it was.

    Cells beside a chart repeat the nearest covered one: a bilinear look-up at the rim of a chart must not blend in black.

    Args:
        sampler: of the room.
        radiance: (N, 3) float32 in texel order, W/(sr m^2).

    Returns:
        (size, size, 3) float32, row 0 at v = 0; 0 far from any chart.
    """
    cells = np.empty((sampler.size * sampler.size, 3), np.float32)
    for channel in range(3):
        sums = np.bincount(
            sampler.cell, weights=radiance[:, channel] * sampler.area, minlength=sampler.size * sampler.size
        )
        cells[:, channel] = sums * sampler.inverse_area
    cells[sampler.gutter_cell] = cells[sampler.gutter_source]
    return cells.reshape(sampler.size, sampler.size, 3)


@dataclass(slots=True)
class AtlasChannel:
    """Remembers what was sent, so that only changed tiles are sent again."""

    sampler: AtlasDownsampler
    room_revision: int
    _sent: NDArray[np.uint32] | None = None
    _sequence: int = 0

    def restart(self) -> None:
        """Send everything next time: there is a new receiver."""
        self._sent = None

    def changes(self, radiance: NDArray[np.float32], timestamp_ns: int) -> AtlasTiles | None:
        """Return the tiles that differ from what was returned before, or None if there are none."""
        words = encode_radiance(downsample_atlas(self.sampler, radiance))
        positions = tile_changes(self._sent, words)
        if len(positions) == 0:
            return None
        self._sent = words
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        return AtlasTiles(
            sequence=self._sequence,
            timestamp_ns=timestamp_ns,
            width=self.sampler.size,
            height=self.sampler.size,
            positions=positions,
            texels=cut_tiles(words, positions),
            room_revision=self.room_revision,
        )
