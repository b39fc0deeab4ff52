"""Texels without a room, for laws that hold for any of them."""

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st

from nearfield_server.pipeline.blocks import BlockPool
from nearfield_server.records import TexelGeometry

# From below the smallest half to far above the largest: what a source may deliver, and what a kernel may be given.
RADIANCES = st.one_of(
    st.sampled_from([0.0, 1e-38, 6e-8, 1e-6, 0.5, 0.5, 1.0, 6e4, 65504.0, 1e9]),
    st.floats(2.0**-20, 60000.0, width=32),
)


@pytest.fixture(scope="session")
def pool() -> BlockPool:
    return BlockPool(1)


@pytest.fixture(scope="session")
def long_run() -> bool:
    """Whether `--hypothesis-profile=long` asks for hours of updates instead of a minute of them."""
    return settings().max_examples > 1000


def loose_texels(position: np.ndarray, normal: np.ndarray, area: np.ndarray) -> TexelGeometry:
    """Texel records that belong to no atlas."""
    count = area.shape[0]
    none = np.zeros(0, dtype=np.int32)
    return TexelGeometry(
        height=1,
        width=count,
        texel_index=np.arange(count, dtype=np.int32),
        position=np.asarray(position, dtype=np.float32),
        normal=np.asarray(normal, dtype=np.float32),
        area=np.asarray(area, dtype=np.float32),
        face=np.zeros(count, dtype=np.int32),
        lookup=np.arange(count, dtype=np.int32)[None],
        gutter_texel=none,
        gutter_source=none,
    )
