"""Runs of blocks that are not stored and lie inside an open mesh, by winding numbers at both their ends.

A run lies between blocks of a band that follow each other along z, or between one and the grid's end. If both its ends
are on one side, so is all of it; else a bisection finds where the side changes. A group of lanes takes the run before
the first block of a row and that after a block, and adds up the boundary edges together.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.band.block_bits import KEPT, RUNS
from sdm.kernels.bvh.tree import SCALE, Tree
from sdm.kernels.geometry.voxel_grid import Slab, voxel
from sdm.kernels.launch import launch
from sdm.kernels.primitives.lanes import GPU_LANES, sum_of_lanes_in_double
from sdm.kernels.winding.boundary_term import Boundary, boundary_part
from sdm.kernels.winding.ray_crossings import count_crossings

wp.set_module_options({"enable_backward": False})


@wp.func
def is_block_inside(tree: Tree, boundary: Boundary, slab: Slab, x: int, y: int, z: int, lane: int, lanes: int):
    """True if a voxel near the middle of a block has a winding number of more than a half. All lanes have to ask."""
    at = wp.min(8 * wp.vec3i(x, y, z) + wp.vec3i(3, 3, 3), slab.shape - wp.vec3i(1, 1, 1))
    p = tree.frame[SCALE] * wp.vec3d(voxel(slab, at[0], at[1], at[2]))
    share = sum_of_lanes_in_double(boundary_part(boundary, tree, 0, p, lane, lanes))
    return float(wp.float64(count_crossings(tree, 0, p)) + share) > 0.5


@wp.func
def part_inside(
    tree: Tree, boundary: Boundary, slab: Slab, x: int, y: int, begin: int, end: int, lane: int, lanes: int
):
    """The part of the blocks from `begin` to before `end` that is inside: its first, and one after its last."""
    if end <= begin:
        return wp.vec2i(0, 0)
    first = is_block_inside(tree, boundary, slab, x, y, begin, lane, lanes)
    last = first
    if end - begin > 1:
        last = is_block_inside(tree, boundary, slab, x, y, end - 1, lane, lanes)
    if first == last:
        return wp.where(first, wp.vec2i(begin, end), wp.vec2i(0, 0))
    # The last block known to be on the side of the first, and the first known not to be.
    low = int(begin)
    high = int(end - 1)
    while high - low > 1:
        middle = (low + high) / 2
        if is_block_inside(tree, boundary, slab, x, y, middle, lane, lanes) == first:
            low = middle
        else:
            high = middle
    return wp.where(first, wp.vec2i(begin, high), wp.vec2i(high, end))


@wp.kernel
def _find_parts(
    begin: int,
    lanes: int,
    tree: Tree,
    boundary: Boundary,
    slab: Slab,
    blocks: wp.array(dtype=wp.vec3i),
    kept: wp.array(dtype=wp.int32),
    last: int,
    counts: wp.array(dtype=wp.int32),
    parts: wp.array(dtype=wp.vec2i),
    numbers: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    at = thread / lanes
    total = counts[KEPT]
    before = wp.vec2i(0, 0)
    after = wp.vec2i(0, 0)
    if at < total:
        mine = blocks[kept[at]]
        is_first = bool(True)
        if at > 0:
            other = blocks[kept[at - 1]]
            is_first = other[0] != mine[0] or other[1] != mine[1]
        end = int(last)
        if at + 1 < total:
            other = blocks[kept[at + 1]]
            if other[0] == mine[0] and other[1] == mine[1]:
                end = other[2]
        if is_first:
            before = part_inside(tree, boundary, slab, mine[0], mine[1], 0, mine[2], lane, lanes)
        after = part_inside(tree, boundary, slab, mine[0], mine[1], mine[2] + 1, end, lane, lanes)
    if lane == 0:
        parts[2 * at] = before
        parts[2 * at + 1] = after
        numbers[2 * at] = wp.where(before[1] > before[0], 1, 0)
        numbers[2 * at + 1] = wp.where(after[1] > after[0], 1, 0)


@wp.kernel
def _write_parts(
    begin: int,
    blocks: wp.array(dtype=wp.vec3i),
    kept: wp.array(dtype=wp.int32),
    parts: wp.array(dtype=wp.vec2i),
    ends: wp.array(dtype=wp.int32),
    runs: wp.array(dtype=wp.vec4i),
    counts: wp.array(dtype=wp.int32),
):
    number = begin + wp.tid()
    if number + 1 == ends.shape[0]:
        counts[RUNS] = ends[number]
    part = parts[number]
    if part[1] > part[0]:
        block = blocks[kept[number / 2]]
        runs[ends[number] - 1] = wp.vec4i(block[0], block[1], part[0], part[1])


def list_open_gaps(
    tree: Tree,
    boundary: Boundary,
    slab: Slab,
    blocks: wp.array,
    kept: wp.array,
    last: int,
    parts: wp.array,
    numbers: wp.array,
    runs: wp.array,
    counts: wp.array,
) -> None:
    """As `block_lists.list_inside_gaps`, of a mesh whose boundary edges are few.

    Args:
        tree: One mesh's hierarchy.
        boundary: Its boundary.
        slab: The grid.
        blocks: (N,) vec3i, of which those of a band are:
        kept: (N,) int32 their places, sorted, as many as `counts` say.
        last: Blocks along z.
        parts: (2 * N,) vec2i, workspace.
        numbers: (4 * N,) int32, workspace.
        runs: (2 * N,) vec4i, as many are filled as there are: x and y, the first z, one after the last.
        counts: `KEPT` is read, and `RUNS` set to how many there are.
    """
    device: Any = kept.device
    lanes = GPU_LANES if device.is_cuda else 1
    found, ends = numbers[: 2 * kept.size], numbers[2 * kept.size :]
    inputs = [lanes, tree, boundary, slab, blocks, kept, last, counts, parts, found]
    launch(_find_parts, kept.size * lanes, inputs, device, smallest=8)
    wp.utils.array_scan(found, ends, inclusive=True)
    launch(_write_parts, 2 * kept.size, [blocks, kept, parts, ends, runs, counts], device)
