import numpy as np

from nearfield_server.pipeline.packed_table import group_by_block, pack_gather_table
from nearfield_server.pipeline.tile_index import index_tiles
from nearfield_server.reference.box_room import BoxRoom


def test_every_tap_of_every_pair_names_its_block(room: BoxRoom) -> None:
    packed = pack_gather_table(room.table)
    block = np.repeat(np.arange(packed.num_texels), np.diff(packed.pair_start)) // 64
    row, column = np.divmod(packed.pixel.astype(np.int64), 96)
    expected = {
        (int(camera), int(r // 32), int(c // 32), int(b))
        for down in (0, 1)
        for right in (0, 1)
        for camera, r, c, b in zip(packed.camera, row + down, column + right, block, strict=True)
    }
    blocks = group_by_block(packed)
    index = index_tiles(blocks)
    assert index.tile_shapes == ((3, 3),) * 4
    found = {
        (tile // 9, tile % 9 // 3, tile % 3, int(b))
        for tile in range(36)
        for b in index.block[index.block_start[tile] : index.block_start[tile + 1]]
    }
    assert found == expected
    assert index.block.size == len(expected)


def test_marked_tiles_give_increasing_blocks(room: BoxRoom) -> None:
    blocks = group_by_block(pack_gather_table(room.table))
    index = index_tiles(blocks)
    tiles = [np.zeros((3, 3), dtype=bool) for _ in range(4)]
    assert index.blocks_of(tiles, blocks.num_blocks).size == 0
    tiles[2][1, 1] = tiles[0][1, 0] = True
    members = {
        int(b)
        for tile in (18 + 4, 3)
        for b in index.block[index.block_start[tile] : index.block_start[tile + 1]]
    }
    np.testing.assert_array_equal(index.blocks_of(tiles, blocks.num_blocks), sorted(members))
