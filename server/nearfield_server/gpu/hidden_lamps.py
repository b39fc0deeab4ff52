"""Hidden lamps on the device: what their receivers show is summed there, the few hundred receivers are judged here.

Six floats per receiver come back instead of the atlas, and three floats per hidden surface go up.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.gpu.context import GlContext
from nearfield_server.pipeline.hidden_light import HiddenLight, explain_receivers

SHADERS = ("receivers", "hidden")
Run = Callable[..., None]
"""`(shader, work groups, buffers, **uniforms)`: binds, dispatches and waits for the writes."""


class HiddenLamps:
    """Static data of the hidden surfaces on the device.

    Args:
        context: holds the buffers.
        hidden: static data with at least one surface.
    """

    def __init__(self, context: GlContext, hidden: HiddenLight) -> None:
        self._hidden = hidden
        upload = context.storage_buffer
        # A receiver that sees nothing has no rays; buffers hold at least one row.
        rays = np.zeros((max(1, hidden.ray_texel.size), 2), dtype=np.uint32)
        rays[: hidden.ray_texel.size, 0] = hidden.ray_texel
        rays[: hidden.ray_texel.size, 1] = hidden.ray_weight.astype(np.float32).view(np.uint32)
        self._first_rays, self._rays = upload(hidden.ray_start.astype(np.uint32)), upload(rays)
        self._patches = upload(hidden.receiver.astype(np.uint32))
        self._texels = upload(np.stack([hidden.texels, hidden.group], axis=1).astype(np.uint32))
        self._shown = context.reserve_buffer(hidden.receiver.shape[0] * 6 * 4)
        self._values = context.reserve_buffer(hidden.num_groups * 3 * 4)

    def update(self, radiance: Any, run: Run) -> None:
        """Find the radiance of the hidden surfaces and write it into the atlas.

        Args:
            radiance: storage buffer of (N, 3) float32, freshly gathered.
            run: starts a shader.
        """
        num_receivers, patch_texels = self._hidden.receiver.shape
        buffers = [radiance, self._first_rays, self._rays, self._patches, self._shown]
        run("receivers", num_receivers, buffers, uPatchTexels=patch_texels)
        shown: NDArray[np.float32] = np.frombuffer(self._shown.read(), dtype=np.float32).reshape(-1, 6)
        values = explain_receivers(self._hidden, shown[:, :3], shown[:, 3:])
        self._values.write(values.astype(np.float32))
        count = self._hidden.texels.size
        run("hidden", -(-count // 64), [self._texels, self._values, radiance], uNumHidden=count)
