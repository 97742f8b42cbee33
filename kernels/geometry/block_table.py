"""Table of the blocks of a narrow band: which of them has a voxel."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# Voxels along the edge of a block: 2^3.
BITS = 3
VOXELS = 512


@wp.struct
class BlockTable:
    """Blocks of 8^3 voxels, sorted by x, then y, then z, and where each row of the same x and y begins."""

    blocks: wp.array(dtype=wp.vec3i)  # (N)
    rows: wp.array(dtype=wp.int32)  # (size[0] * size[1] + 1), the place of a row's first block
    low: wp.vec2i  # x and y of the first row
    size: wp.vec2i  # rows along x and y


@wp.func
def place_of(table: BlockTable, block: wp.vec3i):
    """The place of a block, or -1 if it is not there."""
    x = block[0] - table.low[0]
    y = block[1] - table.low[1]
    if x < 0 or x >= table.size[0] or y < 0 or y >= table.size[1]:
        return -1
    row = x * table.size[1] + y
    low = table.rows[row]
    end = table.rows[row + 1]
    high = int(end)
    while low < high:
        middle = (low + high) / 2
        if table.blocks[middle][2] < block[2]:
            low = middle + 1
        else:
            high = middle
    if low < end:
        if table.blocks[low][2] == block[2]:
            return low
    return -1


@wp.func
def inner_of(at: wp.vec3i):
    """The number of a voxel in its block, z fastest."""
    return ((at[0] & 7) << 6) + ((at[1] & 7) << 3) + (at[2] & 7)


@wp.func
def voxel_of(table: BlockTable, number: int):
    """The voxel that is `number` in the count of all blocks' voxels."""
    inner = number & (VOXELS - 1)
    return 8 * table.blocks[number / VOXELS] + wp.vec3i(inner >> 6, (inner >> 3) & 7, inner & 7)
