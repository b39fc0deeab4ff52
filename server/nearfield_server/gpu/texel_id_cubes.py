"""Texel numbers seen from a point, drawn into the six faces of a cube map (Rohmer et al. 2014, section 4.2).

The faces are 3x2 tiles of one 2D texture, because moderngl cannot attach cube faces. Same result as
`geometry.probes.ProbeRays` except at pixels whose centre lies on a silhouette or a triangle edge.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.gpu.context import GlContext
from nearfield_server.gpu.programs import load_program
from nearfield_server.records import RoomMesh, TexelGeometry

# (axis of the face, its sign, axis of the columns, axis of the rows): the order of radiometry.cube.
_FACES = ((0, 1.0, 1, 2), (0, -1.0, 1, 2), (1, 1.0, 2, 0), (1, -1.0, 2, 0), (2, 1.0, 0, 1), (2, -1.0, 0, 1))
_TILES = (3, 2)
# Near and far plane as shares of the room's diagonal.
_NEAR, _FAR = 5e-4, 2.0


class TexelIdCubes:
    """Draws texel-id cubes of one room; owns its GPU objects until `release`.

    Args:
        context: OpenGL context of this thread.
        mesh: room.
        texels: its texel records, fewer than 2^24.
        resolution: R, pixels along a cube edge.

    Raises:
        GraphicsError: the device cannot hold the room.
    """

    def __init__(
        self, context: GlContext, mesh: RoomMesh, texels: TexelGeometry, resolution: int = 32
    ) -> None:
        self._context = context
        self._resolution = resolution
        low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
        self._origin = 0.5 * (low + high)
        self._diagonal = float(np.linalg.norm(high - low))
        self._program = load_program(context, "texel_id_cube.vert", "texel_id_cube.frag")
        face_of_texel = np.append(texels.face, np.int32(-1))[texels.lookup]
        # Two integers per texel: its position in texel order and its triangle.
        ids = np.stack([texels.lookup, face_of_texel], axis=-1).astype(np.int32)
        self._ids = context.texture(texels.width, texels.height, 2, "i4", ids.tobytes())
        size = (_TILES[0] * resolution, _TILES[1] * resolution)
        self._target = context.texture(*size, 1, "f4")
        self._framebuffer = context.framebuffer([self._target], depth_size=size)
        self._vertices = context.storage_buffer(
            np.hstack([mesh.positions - self._origin, mesh.uv]).astype(np.float32)
        )
        self._indices = context.storage_buffer(mesh.faces.astype(np.uint32))
        self._drawing: Any = context.gl.vertex_array(
            self._program,
            [(self._vertices, "3f 2f", "inPosition", "inUv")],
            index_buffer=self._indices,
            index_element_size=4,
        )
        context.check("texel-id cube")

    def draw(self, centre_world: NDArray[np.float64]) -> NDArray[np.int32]:
        """Texel seen along each direction.

        Args:
            centre_world: (3,) position, world frame.

        Returns:
            (6 R R,) int32 position in texel order or -1, in the order of `radiometry.cube.cube_directions`.
        """
        gl, size = self._context.gl, self._resolution
        self._framebuffer.use()
        self._framebuffer.clear(red=-1.0, depth=1.0)
        gl.disable(gl.CULL_FACE | gl.BLEND)
        gl.enable(gl.DEPTH_TEST)
        self._ids.use(location=0)
        self._program["uTexelIds"].value = 0
        for face, (_, sign, _, _) in enumerate(_FACES):
            self._framebuffer.viewport = (face % 3 * size, face // 3 * size, size, size)
            clip_from_world = self._clip_from_room(
                face, np.asarray(centre_world, dtype=np.float64) - self._origin
            )
            self._program["uClipFromRoom"].write(
                np.ascontiguousarray(clip_from_world.T, dtype=np.float32).tobytes()
            )
            # Columns x rows is the face's axis, so the faces on the positive side are drawn mirrored.
            self._program["uIsMirrored"].value = sign > 0
            self._drawing.render(gl.TRIANGLES)
        self._context.check("texel-id cube")
        tiles = np.frombuffer(self._target.read(), dtype=np.float32).reshape(2, size, 3, size)
        return np.ascontiguousarray(np.rint(tiles.transpose(0, 2, 1, 3)).astype(np.int32).reshape(-1))

    def _clip_from_room(self, face: int, centre: NDArray[np.float64]) -> NDArray[np.float64]:
        """(4, 4) float64: 90 degree projection of one cube face."""
        axis, sign, column_axis, row_axis = _FACES[face]
        near, far = _NEAR * self._diagonal, _FAR * self._diagonal
        clip = np.zeros((4, 4))
        clip[0, column_axis] = 1.0
        clip[1, row_axis] = 1.0
        clip[2, axis] = sign * (far + near) / (far - near)
        clip[3, axis] = sign
        clip[:, 3] = -clip[:, :3] @ centre
        clip[2, 3] -= 2 * far * near / (far - near)
        return clip

    def release(self) -> None:
        """Free the GPU objects."""
        self._context.leave_framebuffer()
        for item in (
            self._drawing, self._indices, self._vertices, self._framebuffer, self._target, self._ids, self._program,
        ):  # fmt: skip
            item.release()
