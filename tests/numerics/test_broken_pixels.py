"""No pixel, however broken, reaches further than the texels that show it."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from nearfield_server.pipeline.blocks import BlockPool
from nearfield_server.pipeline.gather import black_atlas, gather
from nearfield_server.pipeline.packed_table import group_by_block, pack_gather_table
from nearfield_server.radiometry.half import HALF_MAX
from nearfield_server.records import GatherTable

SIDE = 3
HALVES = st.one_of(
    st.sampled_from([np.nan, np.inf, -np.inf, -1.0, 0.0, 6e-8, 1e-6, 1.0, 65504.0]),
    st.floats(0, 65504, width=16),
)
PIXELS = hnp.arrays(np.float16, (2, SIDE, SIDE, 4), elements=HALVES)


@st.composite
def tables(draw: st.DrawFn) -> GatherTable:
    """Some texels, each shown by up to four pixels of two cameras."""
    counts = draw(st.lists(st.integers(0, 4), min_size=1, max_size=5))
    number = sum(counts)
    unit = st.floats(0, 1, width=32)
    return GatherTable(
        pair_start=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        camera=draw(hnp.arrays(np.uint8, number, elements=st.integers(0, 1))),
        pixel=draw(hnp.arrays(np.uint32, number, elements=st.integers(0, SIDE * SIDE - 1))),
        fraction_x=draw(hnp.arrays(np.float32, number, elements=unit)),
        fraction_y=draw(hnp.arrays(np.float32, number, elements=unit)),
        weight=draw(hnp.arrays(np.float32, number, elements=st.floats(2.0**-15, 1, width=32))),
        camera_shapes=((SIDE, SIDE), (SIDE, SIDE)),
    )


def _gather(table: GatherTable, pixels: np.ndarray) -> np.ndarray:
    atlas = black_atlas(np.ones(table.pair_start.size - 1, dtype=np.float32))
    gather(group_by_block(pack_gather_table(table)), [pixels[0], pixels[1]], atlas, BlockPool(1))
    np.testing.assert_array_equal(atlas.block_max[0], atlas.radiance.max(axis=0))
    return atlas.radiance


def _neighbourhood(table: GatherTable, texel: int) -> list[tuple[int, int, int]]:
    """(camera, row, column) of every pixel that the taps of a texel can touch."""
    touched = []
    for pair in range(table.pair_start[texel], table.pair_start[texel + 1]):
        row, column = divmod(int(table.pixel[pair]), SIDE)
        row, column = min(row, SIDE - 2), min(column, SIDE - 2)
        touched += [(int(table.camera[pair]), row + i, column + j) for i in (0, 1) for j in (0, 1)]
    return touched


@given(tables(), PIXELS)
def test_a_texel_is_a_mean_of_its_clean_pixels(table: GatherTable, pixels: np.ndarray) -> None:
    """Convexity: between the least and the greatest pixel that shows it, 0 where none is valid; never NaN or infinite."""
    pixels[..., 3] = np.where(pixels[..., 3] >= 1.0, 1.0, 0.0)
    radiance = _gather(table, pixels)
    clean = np.nan_to_num(np.clip(pixels[..., :3].astype(np.float64), 0.0, HALF_MAX), nan=0.0)
    for texel, found in enumerate(radiance):
        shown = [clean[at] for at in _neighbourhood(table, texel) if pixels[at][3] == 1.0]
        low, high = (np.min(shown, axis=0), np.max(shown, axis=0)) if shown else (np.zeros(3), np.zeros(3))
        invisible = not shown or not found.any()
        assert (found >= (0.0 if invisible else low * (1 - 1e-6))).all()
        assert (found <= high * (1 + 1e-6)).all()


@given(tables(), PIXELS, st.integers(0, 1), st.integers(0, SIDE - 1), st.integers(0, SIDE - 1), HALVES)
def test_a_pixel_changes_no_other_texel(
    table: GatherTable, pixels: np.ndarray, camera: int, row: int, column: int, value: float
) -> None:
    pixels[..., 3] = 1.0
    before = _gather(table, pixels)
    pixels[camera, row, column, :3] = value
    after = _gather(table, pixels)
    for texel in range(before.shape[0]):
        if (camera, row, column) not in _neighbourhood(table, texel):
            np.testing.assert_array_equal(after[texel], before[texel])
