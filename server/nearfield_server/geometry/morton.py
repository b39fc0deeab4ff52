"""Morton order: neighbours in a picture stay near each other in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def morton_code(rows: NDArray[np.integer], columns: NDArray[np.integer]) -> NDArray[np.uint64]:
    """Interleaved bits of (n,) rows and (n,) columns, 16 bits each; sorting by it gives the order."""

    def spread(value: NDArray[np.integer]) -> NDArray[np.uint64]:
        bits = value.astype(np.uint64)
        for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
            bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
        return bits

    return np.asarray((spread(rows) << np.uint64(1)) | spread(columns))
