"""Voxels of a dense map or of blocks of 8^3, read row by row: a segment is eight cells that follow each other along z.

Blocks of a dense map are counted z fastest; a segment of a block is number 8x + y of the block's rows along z. What
the cells of a segment need are four rows of nine values, of which the last belongs to the next block.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

BLOCK, SEGMENTS = 8, 64


@wp.struct
class Voxels:
    """Values of a map, and where each block's are."""

    values: wp.array2d(dtype=wp.float32)  # dense (nx ny, nz), else (64 N, 8)
    shape: wp.vec3i  # voxels of the grid
    along: wp.vec3i  # blocks of the grid along each axis
    dense: wp.int32
    blocks: wp.array2d(dtype=wp.int32)  # (N,3) if not dense: where each block is
    neighbours: wp.array(dtype=wp.int32)  # (8 N): the block 4dx + 2dy + dz further on, -1 if there is none
    level: wp.float32  # what is less is inside


@wp.struct
class Segment:
    """Places of four rows of nine voxels; row 2dx + dy begins dx and dy further on."""

    rows: wp.vec4i  # -1 if there is none
    nexts: wp.vec4i  # rows of the ninth voxels
    column: wp.int32  # of the first voxels
    next_column: wp.int32  # of the ninth ones
    voxels: wp.int32  # of the first eight that are in the grid


@wp.func
def block_place(voxels: Voxels, block: int):
    """The place of a block among the blocks of its grid."""
    if voxels.dense != 0:
        row = block / voxels.along[2]
        return wp.vec3i(row / voxels.along[1], row % voxels.along[1], block % voxels.along[2])
    return wp.vec3i(voxels.blocks[block, 0], voxels.blocks[block, 1], voxels.blocks[block, 2])


@wp.func
def block_beyond(voxels: Voxels, block: int, way: int):
    """The block 4dx + 2dy + dz = `way` further on, -1 if there is none."""
    if way == 0:
        return block
    if voxels.dense == 0:
        return voxels.neighbours[8 * block + way]
    at = block_place(voxels, block)
    x = at[0] + (way >> 2)
    y = at[1] + ((way >> 1) & 1)
    z = at[2] + (way & 1)
    if x >= voxels.along[0] or y >= voxels.along[1] or z >= voxels.along[2]:
        return -1
    return (x * voxels.along[1] + y) * voxels.along[2] + z


@wp.func
def segment_of(voxels: Voxels, block: int, line: int):
    """The rows of a segment; its first voxel may be beyond the grid, and then all rows are -1."""
    found = Segment()
    found.rows = wp.vec4i(-1, -1, -1, -1)
    found.nexts = wp.vec4i(-1, -1, -1, -1)
    at = block_place(voxels, block)
    x = BLOCK * at[0] + line / BLOCK
    y = BLOCK * at[1] + line % BLOCK
    z = BLOCK * at[2]
    found.voxels = wp.min(BLOCK, voxels.shape[2] - z)
    more = z + BLOCK < voxels.shape[2]
    if voxels.dense != 0:
        found.column = z
        found.next_column = z + BLOCK
    for q in range(4):
        dx = q >> 1
        dy = q & 1
        if x + dx < voxels.shape[0] and y + dy < voxels.shape[1]:
            if voxels.dense != 0:
                found.rows[q] = (x + dx) * voxels.shape[1] + y + dy
                if more:
                    found.nexts[q] = found.rows[q]
            else:
                i = line / BLOCK + dx
                j = line % BLOCK + dy
                way = 4 * (i / BLOCK) + 2 * (j / BLOCK)
                row = BLOCK * (i % BLOCK) + j % BLOCK
                here = block_beyond(voxels, block, way)
                if here >= 0:
                    found.rows[q] = SEGMENTS * here + row
                if more:
                    beyond = block_beyond(voxels, block, way + 1)
                    if beyond >= 0:
                        found.nexts[q] = SEGMENTS * beyond + row
    return found


@wp.func
def value_at(voxels: Voxels, segment: Segment, q: int, k: int):
    """The value of voxel k < 9 of row q, which is there."""
    if k < BLOCK:
        return voxels.values[segment.rows[q], segment.column + k]
    return voxels.values[segment.nexts[q], segment.next_column]


@wp.func
def are_there(segment: Segment, q: int):
    """A bit for each voxel of row q that is there."""
    bits = int(0)
    if segment.rows[q] >= 0:
        bits = (1 << segment.voxels) - 1
    if segment.nexts[q] >= 0:
        bits = bits | (1 << BLOCK)
    return bits
