/** Fragments per side of a tile. */
export const TILE_SIZE = 8

export function tilesAcross(size: number): number {
  return Math.ceil(size / TILE_SIZE)
}

/** Draws one point per tile of a target, with whole tiles in the viewport; the vertex stage (shaders/tile*.vert) picks tiles. */
export function drawTiles(gl: WebGL2RenderingContext, width: number, height: number): void {
  const columns = tilesAcross(width)
  const rows = tilesAcross(height)
  gl.viewport(0, 0, columns * TILE_SIZE, rows * TILE_SIZE)
  gl.bindVertexArray(null)
  gl.drawArrays(gl.POINTS, 0, columns * rows)
  gl.viewport(0, 0, width, height)
}
