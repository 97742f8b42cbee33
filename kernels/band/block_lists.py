"""Lists made from the blocks of a band: those that are kept, and the gaps between them."""

from __future__ import annotations

import warp as wp

from sdm.kernels.band.block_bits import KEPT, RUNS
from sdm.kernels.geometry.block_table import VOXELS
from sdm.kernels.launch import launch
from sdm.kernels.primitives.vector_loads import load4, write4

wp.set_module_options({"enable_backward": False})


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
def _keep(begin: int, ends: wp.array(dtype=wp.int32), kept: wp.array(dtype=wp.int32), counts: wp.array(dtype=wp.int32)):
    place = begin + wp.tid()
    before = int(0)
    if place > 0:
        before = ends[place - 1]
    if ends[place] > before:
        kept[before] = place
    if place + 1 == ends.shape[0]:
        counts[KEPT] = ends[place]


def keep_near(near: wp.array, ends: wp.array, kept: wp.array, counts: wp.array) -> None:
    """List the blocks with a voxel in the band, in their order.

    Args:
        near: (N,) int32, 1 for these and 0 for others.
        ends: (N,) int32, workspace.
        kept: (N,) int32, as many places are filled as there are.
        counts: `KEPT` is set to how many.
    """
    wp.utils.array_scan(near, ends, inclusive=True)
    launch(_keep, near.size, [ends, kept, counts], near.device)


@wp.kernel
def _gather(
    begin: int,
    blocks: wp.array(dtype=wp.vec3i),
    shape: wp.vec3i,
    first: int,
    width: float,
    kept: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
    runs: wp.array(dtype=wp.vec4i),
    counts: wp.array(dtype=wp.int32),
    found_blocks: wp.array(dtype=wp.vec3i),
    found: wp.array(dtype=wp.float32),
    found_runs: wp.array(dtype=wp.vec4i),
):
    thread = begin + wp.tid()
    # Four voxels of a row.
    number = thread >> 7
    quad = thread & 127
    if quad < 2 and 2 * number + quad < wp.min(counts[RUNS], found_runs.shape[0]):
        found_runs[2 * number + quad] = runs[2 * number + quad]
    if number >= wp.min(counts[KEPT], found_blocks.shape[0]):
        return
    place = kept[number]
    block = blocks[place]
    if quad == 0:
        found_blocks[number] = block + wp.vec3i(first, 0, 0)
    four = load4(values, (VOXELS / 4) * place + quad)
    row = quad >> 1
    z = 8 * block[2] + 4 * (quad & 1)
    within = 8 * block[0] + (row >> 3) < shape[0] and 8 * block[1] + (row & 7) < shape[1]
    if not within or z + 4 > shape[2]:
        for k in range(4):
            if not within or z + k >= shape[2]:
                four[k] = width
    write4(found, (VOXELS / 4) * number + quad, four[0], four[1], four[2], four[3])


def gather_blocks(
    blocks: wp.array,
    shape: tuple[int, int, int],
    first: int,
    width: float,
    kept: wp.array,
    values: wp.array,
    runs: wp.array,
    counts: wp.array,
    found_blocks: wp.array,
    found: wp.array,
    found_runs: wp.array,
) -> None:
    """Copy blocks and values of some places, and runs; voxels beyond a grid of this shape get the width.

    Args:
        blocks: (N,) vec3i, all.
        shape: Voxels of the grid.
        first: Added to the x of those copied.
        width: See above.
        kept: (N,) int32 places, as many as there are.
        values: (N * 512) of all.
        runs: vec4i, as many as there are.
        counts: `KEPT` and `RUNS` are read.
        found_blocks: (M,) vec3i, filled as far as there are places.
        found: (M * 512), filled as far.
        found_runs: At most (2 * M,) vec4i, filled as far as there are runs.
    """
    inputs = [blocks, wp.vec3i(*shape), first, width, kept, values, runs, counts, found_blocks, found, found_runs]
    launch(_gather, (VOXELS // 4) * found_blocks.size, inputs, found.device)


@wp.func
def inside_around(
    at: int,
    total: int,
    blocks: wp.array(dtype=wp.vec3i),
    kept: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
    last: int,
):
    """Sides of what is before a kept block in its row and of what comes after it, 1 for inside; and where that ends."""
    mine = blocks[kept[at]]
    first = bool(True)
    if at > 0:
        other = blocks[kept[at - 1]]
        first = other[0] != mine[0] or other[1] != mine[1]
    end = int(last)
    if at + 1 < total:
        other = blocks[kept[at + 1]]
        if other[0] == mine[0] and other[1] == mine[1]:
            end = other[2]
    # The first voxels along x and y are within the grid, and the last along z if something comes after them.
    before = int(0)
    if first and mine[2] > 0 and values[VOXELS * kept[at]] < 0.0:
        before = int(1)
    after = int(0)
    if mine[2] + 1 < end and values[VOXELS * kept[at] + 7] < 0.0:
        after = int(1)
    return wp.vec3i(before, after, end)


@wp.kernel
def _count_gaps(
    begin: int,
    blocks: wp.array(dtype=wp.vec3i),
    kept: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
    last: int,
    counts: wp.array(dtype=wp.int32),
    gaps: wp.array(dtype=wp.int32),
):
    at = begin + wp.tid()
    mine = int(0)
    if at < counts[KEPT]:
        found = inside_around(at, counts[KEPT], blocks, kept, values, last)
        mine = found[0] + found[1]
    gaps[at] = mine


@wp.kernel
def _write_gaps(
    begin: int,
    blocks: wp.array(dtype=wp.vec3i),
    kept: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
    last: int,
    ends: wp.array(dtype=wp.int32),
    runs: wp.array(dtype=wp.vec4i),
    counts: wp.array(dtype=wp.int32),
):
    at = begin + wp.tid()
    if at + 1 == ends.shape[0]:
        counts[RUNS] = ends[at]
    if at < counts[KEPT]:
        place = int(0)
        if at > 0:
            place = ends[at - 1]
        if place < ends[at]:
            found = inside_around(at, counts[KEPT], blocks, kept, values, last)
            mine = blocks[kept[at]]
            if found[0] != 0:
                runs[place] = wp.vec4i(mine[0], mine[1], 0, mine[2])
                place = place + 1
            if found[1] != 0:
                runs[place] = wp.vec4i(mine[0], mine[1], mine[2] + 1, found[2])


def list_inside_gaps(
    blocks: wp.array, kept: wp.array, values: wp.array, last: int, gaps: wp.array, runs: wp.array, counts: wp.array
) -> None:
    """List the runs of blocks along z, between those of a band, that lie inside a closed mesh, in their order.

    Next to a block that is not there such a mesh has no surface, so it is on the side of any voxel that faces it.

    Args:
        blocks: (N,) vec3i, of which those of a band are:
        kept: (N,) int32 their places, sorted, as many as `counts` say.
        values: (N * 512) the signed distances of all.
        last: Blocks along z.
        gaps: (2 * N,) int32, workspace.
        runs: (2 * N,) vec4i, as many are filled as there are: x and y, the first z, one after the last.
        counts: `KEPT` is read, and `RUNS` set to how many there are.
    """
    numbers, ends = gaps[: kept.size], gaps[kept.size :]
    launch(_count_gaps, kept.size, [blocks, kept, values, last, counts, numbers], kept.device)
    wp.utils.array_scan(numbers, ends, inclusive=True)
    launch(_write_gaps, kept.size, [blocks, kept, values, last, ends, runs, counts], kept.device)
