"""Changed tiles of the radiance atlas, for clients that draw the room from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol import quantise
from nearfield_protocol.errors import EncodeError
from nearfield_protocol.framing import HEADER_BYTES, Reader, check_limit, frame, require, write_record
from nearfield_protocol.layout import (
    ATLAS_TILE_POSITION,
    ATLAS_TILE_SIZE,
    ATLAS_TILES,
    MAX_ATLAS_TILES_PER_SIDE,
    MessageType,
)

T = ATLAS_TILE_SIZE


@dataclass(frozen=True, slots=True, kw_only=True)
class AtlasTiles:
    """Some tiles of the streamed atlas.

    Attributes:
        sequence: counts messages of this type, wrapping.
        timestamp_ns: capture time of the oldest camera frame that took part.
        room_revision: of the room model.
        width: of the whole streamed atlas, texels. height: of it.
        positions: (n, 2) uint16 column and row of each tile, ascending by row, then column.
        texels: (n, 32, 32) uint32 RGB9_E5 radiance, row 0 on top.
    """

    sequence: int
    timestamp_ns: int
    width: int
    height: int
    positions: NDArray[np.uint16]
    texels: NDArray[np.uint32]
    room_revision: int = 0


def encode_radiance(radiance: NDArray[np.floating[Any]]) -> NDArray[np.uint32]:
    """RGB radiance (..., 3) as RGB9_E5 words (...,).

    The error of a channel is at most 0.196 % of the texel's largest channel (and at least 3e-8); radiance above 65408 saturates.

    Raises:
        EncodeError: A value is negative or not finite.
    """
    values = np.asarray(radiance)
    if not ((values >= 0) & (values < np.inf)).all():
        raise EncodeError("radiance", expected="finite numbers >= 0", found="a negative or non-finite one")
    return quantise.encode_rgb9e5(values)


def decode_radiance(texels: NDArray[np.uint32]) -> NDArray[np.float32]:
    """RGB9_E5 words (...,) as RGB radiance (..., 3), exactly."""
    return quantise.decode_rgb9e5(texels)


def tile_changes(previous: NDArray[np.uint32] | None, current: NDArray[np.uint32]) -> NDArray[np.uint16]:
    """Columns and rows (n, 2) of the tiles in which two RGB9_E5 atlases (height, width) differ; all of them without a previous one.

    Raises:
        EncodeError: The sizes differ, or the atlas is not whole tiles.
    """
    height, width = _checked_size(current.shape)
    if previous is None:
        changed = np.ones((height // T, width // T), np.bool_)
    elif previous.shape != current.shape:
        raise EncodeError("previous", expected=current.shape, found=previous.shape)
    else:
        changed = (previous != current).reshape(height // T, T, width // T, T).any(axis=(1, 3))
    return np.argwhere(changed)[:, ::-1].astype(np.uint16)


def cut_tiles(atlas: NDArray[np.uint32], positions: NDArray[np.uint16]) -> NDArray[np.uint32]:
    """The tiles (n, 32, 32) of an atlas (height, width) at columns and rows (n, 2)."""
    height, width = _checked_size(atlas.shape)
    blocks = atlas.reshape(height // T, T, width // T, T).swapaxes(1, 2)
    return np.ascontiguousarray(blocks[positions[:, 1], positions[:, 0]])


def paste_tiles(atlas: NDArray[np.uint32], tiles: AtlasTiles) -> None:
    """Write the tiles into an atlas (height, width) in place."""
    height, width = _checked_size(atlas.shape)
    if (height, width) != (tiles.height, tiles.width):
        raise EncodeError("atlas", expected=(tiles.height, tiles.width), found=(height, width))
    blocks = atlas.reshape(height // T, T, width // T, T).swapaxes(1, 2)
    blocks[tiles.positions[:, 1], tiles.positions[:, 0]] = tiles.texels


def encode_atlas_tiles(tiles: AtlasTiles) -> bytes:
    """Write an atlas message.

    Raises:
        EncodeError: Sizes do not fit together, or tiles lie outside, repeat or are out of order.
    """
    height, width = _checked_size((tiles.height, tiles.width))
    positions = np.asarray(tiles.positions, np.int64).reshape(-1, 2)
    if tiles.texels.shape != (len(positions), T, T) or tiles.texels.dtype != np.uint32:
        raise EncodeError(
            "texels",
            expected=f"uint32 ({len(positions)}, {T}, {T})",
            found=f"{tiles.texels.dtype} {tiles.texels.shape}",
        )
    first_bad = _first_bad_tile(positions, width, height)
    if first_bad is not None:
        raise EncodeError(
            f"positions[{first_bad}]",
            expected=f"ascending columns and rows inside {width // T} x {height // T} tiles",
            found=positions[first_bad].tolist(),
        )
    table = np.zeros(len(positions), ATLAS_TILE_POSITION)
    table["column"], table["row"] = positions[:, 0], positions[:, 1]
    head = write_record(
        ATLAS_TILES,
        timestamp_ns=tiles.timestamp_ns,
        room_revision=tiles.room_revision,
        width=width,
        height=height,
        num_tiles=len(positions),
    )
    return frame(
        MessageType.ATLAS_TILES, tiles.sequence, head, table.tobytes(), tiles.texels.astype("<u4").tobytes()
    )


def decode_atlas_tiles(data: bytes) -> AtlasTiles:
    """Read an atlas message.

    Raises:
        DecodeError: The bytes are not a valid atlas message.
    """
    reader = Reader(data)
    reader.expect(MessageType.ATLAS_TILES)
    head = reader.record(ATLAS_TILES, "atlas_tiles")
    width, height, count = int(head["width"]), int(head["height"]), int(head["num_tiles"])
    for name, size, offset in (("width", width, HEADER_BYTES + 12), ("height", height, HEADER_BYTES + 14)):
        require(size > 0 and size % T == 0, name, offset=offset, expected=f"a multiple of {T}", found=size)
        check_limit(name, size, T * MAX_ATLAS_TILES_PER_SIDE, offset)
    check_limit("num_tiles", count, (width // T) * (height // T), HEADER_BYTES + 16)
    start = reader.offset
    table = reader.array(ATLAS_TILE_POSITION, count, "atlas_tile_position")
    positions = np.stack([table["column"], table["row"]], axis=-1).astype(np.uint16)
    bad = _first_bad_tile(positions.astype(np.int64), width, height)
    if bad is not None:
        require(
            False,
            f"atlas_tile_position[{bad}]",
            offset=start + 4 * bad,
            expected="ascending tiles inside",
            found=positions[bad],
        )
    texels = reader.array("<u4", count * T * T, "texels").reshape(count, T, T).astype(np.uint32)
    reader.end()
    return AtlasTiles(
        sequence=reader.header.sequence,
        timestamp_ns=int(head["timestamp_ns"]),
        room_revision=int(head["room_revision"]),
        width=width,
        height=height,
        positions=positions,
        texels=texels,
    )


def _first_bad_tile(positions: NDArray[np.int64], width: int, height: int) -> int | None:
    inside = ((positions >= 0) & (positions < (width // T, height // T))).all(axis=1)
    order = positions[:, 1] * (width // T) + positions[:, 0]
    ascends = np.diff(order, prepend=-1) > 0
    valid = inside & ascends
    return None if valid.all() else int(np.argmin(valid))


def _checked_size(shape: tuple[int, ...]) -> tuple[int, int]:
    if len(shape) != 2 or any(size <= 0 or size % T or size > T * MAX_ATLAS_TILES_PER_SIDE for size in shape):
        raise EncodeError(
            "atlas",
            expected=f"height and width in whole tiles of {T}, at most {MAX_ATLAS_TILES_PER_SIDE}",
            found=shape,
        )
    return shape[0], shape[1]
