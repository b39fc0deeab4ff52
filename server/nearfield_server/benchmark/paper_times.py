"""Stage times as Rohmer et al. 2014 print them (Table 1, GeForce GTX 580, four cameras, 1024^2 texels, 16 lights), milliseconds."""

from __future__ import annotations

from typing import Final

PAPER_STAGE_MS: Final[dict[str, tuple[str, float]]] = {
    "gather": ("project four cameras, combine", 4 * 0.44 + 0.58),
    "split": ("threshold, split", 9.1 + 0.53),
    "sample": ("importance sampling", 6.67),
    "cluster": ("k-means", 7.3),
    "integrate": ("assign and integrate", 17.5),
}
"""Per stage of ours: the paper's stages that do the same, and their sum; its acquisition, depth maps and dilation come on top."""
