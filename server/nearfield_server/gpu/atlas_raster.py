"""Which triangle covers which atlas texel, by the rasteriser of the graphics card (Rohmer et al. 2014, section 4.1).

The UV coordinates are drawn as positions, as in the paper. Differs from the paper: only the triangle number is drawn;
position, normal and area follow from it in float64 (`geometry.texels`), the same way for both rasterisers.

OpenGL snaps vertices to 1/256 texel (the CPU rasteriser to 1/4096) and may resolve ties the other way round, so texels
whose centre lies within 1/256 texel of an edge can differ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nearfield_server.gpu.context import GlContext
from nearfield_server.gpu.programs import load_program


def cover_texels_gl(
    context: GlContext, uv: NDArray[np.float64], faces: NDArray[np.int32], height: int, width: int
) -> NDArray[np.int32]:
    """Triangle that owns each texel.

    Args:
        context: OpenGL context of this thread.
        uv: (V, 2), glTF convention.
        faces: (F, 3), fewer than 2^24 triangles, either orientation.
        height: atlas rows.
        width: atlas columns.

    Returns:
        (height, width) int32 triangle index, or -1.

    Raises:
        GraphicsError: the atlas is too large for the device, or a GL call failed.
    """
    program = load_program(context, "atlas_face.vert", "atlas_face.frag")
    # float32 holds whole numbers below 2^24 exactly, and unlike integer targets it can be cleared by every driver.
    target = context.texture(width, height, 1, "f4")
    framebuffer = context.framebuffer([target])
    vertices = context.storage_buffer(uv.astype(np.float32))
    indices = context.storage_buffer(faces.astype(np.uint32))
    drawing = context.gl.vertex_array(
        program, [(vertices, "2f", "inUv")], index_buffer=indices, index_element_size=4
    )
    framebuffer.use()
    framebuffer.clear(red=-1.0)
    context.gl.disable(context.gl.CULL_FACE | context.gl.DEPTH_TEST | context.gl.BLEND)
    drawing.render(context.gl.TRIANGLES)
    context.check("atlas raster")
    values = np.frombuffer(target.read(), dtype=np.float32).reshape(height, width)
    context.leave_framebuffer()
    for item in (drawing, indices, vertices, framebuffer, target, program):
        item.release()
    return np.rint(values).astype(np.int32)
