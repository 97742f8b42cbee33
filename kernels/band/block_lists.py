"""Lists made from the blocks of a band: the regions that have some, the blocks that are kept, the gaps between them."""

from __future__ import annotations

import warp as wp

from sdm.kernels.geometry.block_table import VOXELS, BlockTable, place_of
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _list_regions(
    begin: int, table: BlockTable, bits: int, regions: wp.array(dtype=wp.vec4i), counts: wp.array(dtype=wp.int32)
):
    """The first block of each region lists it, with a bit for each of its cells of 2^bits blocks that has a block."""
    place = begin + wp.tid()
    mine = table.blocks[place]
    edge = 2 << bits
    region = wp.vec3i(mine[0] >> (bits + 1), mine[1] >> (bits + 1), mine[2] >> (bits + 1))
    cells = int(0)
    for number in range(edge * edge * edge):
        i = number / (edge * edge)
        j = (number / edge) % edge
        k = number % edge
        if ((cells >> (4 * (i >> bits) + 2 * (j >> bits) + (k >> bits))) & 1) == 0:
            other = place_of(table, edge * region + wp.vec3i(i, j, k))
            if other >= 0:
                # Somebody else is the first.
                if cells == 0 and other != place:
                    return
                cells = cells | (1 << (4 * (i >> bits) + 2 * (j >> bits) + (k >> bits)))
    regions[fetch_add(counts, 0, 1)] = wp.vec4i(region[0], region[1], region[2], cells)


def list_regions_of(table: BlockTable, bits: int, regions: wp.array, counts: wp.array) -> None:
    """List the regions of 2^3 cells of 2^bits blocks that have a block, in any order.

    Args:
        table: The blocks (N,).
        bits: 0 or 1.
        regions: (N,) vec4i, as many are filled as there are: place of the region, and a bit for each cell with a block.
        counts: (1,) int32, zero; how many there are.
    """
    launch(_list_regions, regions.size, [table, bits, regions, counts], regions.device)


@wp.kernel
def _pack(begin: int, places: wp.array(dtype=wp.int32), stride: int, along: wp.vec3i, keys: wp.array(dtype=wp.int64)):
    at = begin + wp.tid()
    row = wp.int64(places[stride * at]) * wp.int64(along[1]) + wp.int64(places[stride * at + 1])
    keys[at] = row * wp.int64(along[2]) + wp.int64(places[stride * at + 2])


def pack_keys(places: wp.array, stride: int, along: tuple[int, int, int], keys: wp.array) -> None:
    """Numbers of blocks, as `sdm.core.block_lookup.keys_of` has them, by one launch.

    Args:
        places: (N * stride,) int32, of which the first three of each `stride` are a block.
        stride: See above.
        along: Blocks along each axis.
        keys: (N,) int64, filled.
    """
    launch(_pack, keys.size, [places, stride, wp.vec3i(*along), keys], keys.device)


@wp.kernel
def _unpack(
    begin: int,
    keys: wp.array(dtype=wp.int64),
    along: wp.vec3i,
    blocks: wp.array(dtype=wp.vec3i),
    lines: wp.array(dtype=wp.int64),
):
    at = begin + wp.tid()
    row = keys[at] / wp.int64(along[2])
    x = row / wp.int64(along[1])
    y = row % wp.int64(along[1])
    z = keys[at] % wp.int64(along[2])
    blocks[at] = wp.vec3i(wp.int32(x), wp.int32(y), wp.int32(z))
    lines[at] = (y * wp.int64(along[2]) + z) * wp.int64(along[0]) + x


def unpack_keys(keys: wp.array, along: tuple[int, int, int], blocks: wp.array, lines: wp.array) -> None:
    """Blocks of keys, and numbers by which they are sorted by y, then z, then x, by one launch.

    Args:
        keys: (N,) int64.
        along: Blocks along each axis.
        blocks: (N,) vec3i, filled.
        lines: (N,) int64, filled.
    """
    launch(_unpack, keys.size, [keys, wp.vec3i(*along), blocks, lines], keys.device)


@wp.kernel
def _gather(
    begin: int,
    table: BlockTable,
    shape: wp.vec3i,
    width: float,
    kept: wp.array(dtype=wp.int64),
    values: wp.array(dtype=wp.float32),
    blocks: wp.array(dtype=wp.vec3i),
    found: wp.array(dtype=wp.float32),
):
    thread = begin + wp.tid()
    # One row of eight voxels.
    number = thread >> 6
    row = thread & 63
    place = int(kept[number])
    block = table.blocks[place]
    if row == 0:
        blocks[number] = block
    within = 8 * block[0] + (row >> 3) < shape[0] and 8 * block[1] + (row & 7) < shape[1]
    for k in range(8):
        value = values[VOXELS * place + 8 * row + k]
        if not within or 8 * block[2] + k >= shape[2]:
            value = width
        found[VOXELS * number + 8 * row + k] = value


def gather_blocks(
    table: BlockTable,
    shape: tuple[int, int, int],
    width: float,
    kept: wp.array,
    values: wp.array,
    blocks: wp.array,
    found: wp.array,
) -> None:
    """Copy blocks and values of some places; voxels beyond a grid of this shape get the width.

    Args:
        table: All blocks (N,).
        shape: Voxels of the grid.
        width: See above.
        kept: (M,) int64 places.
        values: (N * 512) of all.
        blocks: (M,) vec3i, filled.
        found: (M * 512), filled.
    """
    inputs = [table, wp.vec3i(*shape), width, kept, values, blocks, found]
    launch(_gather, 64 * kept.size, inputs, found.device)


@wp.kernel
def _list_gaps(
    begin: int,
    blocks: wp.array(dtype=wp.vec3i),
    values: wp.array(dtype=wp.float32),
    last: int,
    runs: wp.array(dtype=wp.vec4i),
    counts: wp.array(dtype=wp.int32),
):
    place = begin + wp.tid()
    mine = blocks[place]
    first = bool(True)
    if place > 0:
        other = blocks[place - 1]
        first = other[0] != mine[0] or other[1] != mine[1]
    end = int(last)
    if place + 1 < blocks.shape[0]:
        other = blocks[place + 1]
        if other[0] == mine[0] and other[1] == mine[1]:
            end = other[2]
    # The first voxels along x and y are within the grid, and the last along z if something comes after them.
    if first and mine[2] > 0 and values[VOXELS * place] < 0.0:
        runs[fetch_add(counts, 0, 1)] = wp.vec4i(mine[0], mine[1], 0, mine[2])
    if mine[2] + 1 < end and values[VOXELS * place + 7] < 0.0:
        runs[fetch_add(counts, 0, 1)] = wp.vec4i(mine[0], mine[1], mine[2] + 1, end)


def list_inside_gaps(blocks: wp.array, values: wp.array, last: int, runs: wp.array, counts: wp.array) -> None:
    """List the runs of blocks along z, between those of a band, that lie inside a closed mesh.

    Next to a block that is not there such a mesh has no surface, so it is on the side of any voxel that faces it.

    Args:
        blocks: (N,) vec3i, sorted.
        values: (N * 512) their signed distances.
        last: Blocks along z.
        runs: (2 * N,) vec4i, as many are filled as there are, in any order: x and y, the first z, one after the last.
        counts: (1,) int32, zero; how many there are.
    """
    launch(_list_gaps, blocks.size, [blocks, values, last, runs, counts], runs.device)
