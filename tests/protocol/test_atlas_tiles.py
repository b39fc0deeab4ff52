"""Atlas tiles: what changed, cut and pasted, is the atlas again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nearfield_protocol import codec
from nearfield_protocol.errors import EncodeError


def message(atlas: np.ndarray, positions: np.ndarray) -> codec.AtlasTiles:
    tiles = codec.AtlasTiles(
        sequence=1,
        timestamp_ns=2,
        width=atlas.shape[1],
        height=atlas.shape[0],
        positions=positions,
        texels=codec.cut_tiles(atlas, positions),
    )
    return codec.decode_atlas_tiles(codec.encode_atlas_tiles(tiles))


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 4), st.integers(1, 4), st.integers(0, 20), st.integers(0, 2**31))
def test_changes_reproduce_the_atlas(rows: int, columns: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    previous = rng.integers(0, 2**32, (32 * rows, 32 * columns), dtype=np.uint64).astype(np.uint32)
    current = previous.copy()
    touched = set()
    for _ in range(count):
        y, x = int(rng.integers(32 * rows)), int(rng.integers(32 * columns))
        current[y, x] = previous[y, x] ^ 1
        touched.add((x // 32, y // 32))
    positions = codec.tile_changes(previous, current)
    assert {tuple(position) for position in positions.tolist()} == touched
    rebuilt = previous.copy()
    codec.paste_tiles(rebuilt, message(current, positions))
    np.testing.assert_array_equal(rebuilt, current)


def test_everything_is_new_without_a_previous_atlas() -> None:
    atlas = np.arange(64 * 96, dtype=np.uint32).reshape(64, 96)
    rebuilt = np.zeros_like(atlas)
    codec.paste_tiles(rebuilt, message(atlas, codec.tile_changes(None, atlas)))
    np.testing.assert_array_equal(rebuilt, atlas)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(0, 65504), min_size=3, max_size=3))
def test_radiance_error(rgb: list[float]) -> None:
    found = codec.decode_radiance(codec.encode_radiance(np.array(rgb)[None]))[0]
    allowed = np.minimum(np.array(rgb), 65408)
    assert (np.abs(found - allowed) <= max(max(rgb) / 511.5, 2.0**-25)).all()


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf])
def test_radiance_that_cannot_be_written(bad: float) -> None:
    with pytest.raises(EncodeError):
        codec.encode_radiance(np.array([[1.0, bad, 1.0]]))


@pytest.mark.parametrize("positions", [[(1, 0), (0, 0)], [(0, 0), (0, 0)], [(2, 0)], [(0, 1)]])
def test_tiles_in_disorder_or_outside(positions: list[tuple[int, int]]) -> None:
    with pytest.raises(EncodeError, match=r"positions\[\d\]"):
        codec.encode_atlas_tiles(
            codec.AtlasTiles(
                sequence=0,
                timestamp_ns=0,
                width=64,
                height=32,
                positions=np.array(positions, np.uint16),
                texels=np.zeros((len(positions), 32, 32), np.uint32),
            )
        )
