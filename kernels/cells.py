"""First stage of the dense query: for each cell of 8^3 voxels, the triangles that can be nearest to any of its voxels.

One group of lanes descends the tree for one cell, a batch of nodes at a time. Lists have no length known before, so
they are chains of chunks from a pool. A cell that finds the pool empty is marked, and its voxels are searched one by
one later: slower, never wrong.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cull import Cell, agree, away, box_is_behind, no_witness, remember, triangle_is_behind
from sdm.kernels.frames import load_frame, see
from sdm.kernels.grid import Slab, voxel
from sdm.kernels.lanes import (
    ballot,
    fetch_add_once,
    members,
    rank,
    wait_for_lanes,
)
from sdm.kernels.parts import Parts, parts_that_matter
from sdm.kernels.tree import FRAME_SIZE, SCALE, TRIANGLES_PER_LEAF, Tree, box_distance2, first_triangle

wp.set_module_options({"enable_backward": False})

# Voxels along the edge of a cell.
CELL = wp.constant(8)
CHUNK = 128
ROOM = 127  # entries of a chunk; the last place names the next chunk
# Every batch of 32 nodes leaves at most 32 more on the stack than it took, at each of up to 27 levels; leaves that
# wait, at most 8 and the 64 of one batch, grow from the other end.
STACK = 1024
# Sides on which a cell looks for witnesses before it descends.
PROBES = wp.constant(32)
# A multiprocessor of a GPU holds so many blocks of 128 threads at a time; the compiler shares out registers by it.
BLOCKS = 4
# Places of the shared counts.
NEXT_CELL, NEXT_CHUNK, NEXT_BRICK, COUNTS = 0, 1, 2, 4

_CHUNK = wp.constant(CHUNK)
_ROOM = wp.constant(ROOM)
_STACK = wp.constant(STACK)
_NEXT_CELL = wp.constant(NEXT_CELL)
_NEXT_CHUNK = wp.constant(NEXT_CHUNK)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
_LEAF = wp.constant(TRIANGLES_PER_LEAF)


@wp.struct
class Lists:
    """The cells of one pass, and their lists of triangles (slots)."""

    cells: wp.vec3i  # cells along each axis of the slab
    first: wp.int32  # first cell of this pass, counting through the meshes
    count: wp.int32  # cells of this pass
    heads: wp.array(dtype=wp.int32)  # (count) first chunk, or -1: the pool ran out
    lengths: wp.array(dtype=wp.int32)  # (count) entries
    pool: wp.array(dtype=wp.int32)  # (chunks * CHUNK)
    chunks: wp.int32
    counts: wp.array(dtype=wp.int32)  # (COUNTS) shared counters, zero at the start


@wp.func
def make_cell(slab: Slab, start: wp.vec3i, size: int, scale: float):
    """The cell of up to size^3 voxels from `start`, in scaled coordinates."""
    last = wp.min(start + wp.vec3i(size, size, size), slab.shape) - wp.vec3i(1, 1, 1)
    low = voxel(slab, start[0], start[1], start[2])
    high = voxel(slab, last[0], last[1], last[2])
    if slab.turned != 0:
        # The box around all corners of a turned cell.
        for corner in range(8):
            p = voxel(
                slab,
                wp.where((corner & 1) != 0, last[0], start[0]),
                wp.where((corner & 2) != 0, last[1], start[1]),
                wp.where((corner & 4) != 0, last[2], start[2]),
            )
            low = wp.min(low, p)
            high = wp.max(high, p)
    low = scale * low
    high = scale * high
    cell = Cell()
    cell.centre = 0.5 * (low + high)
    half = wp.max(high - cell.centre, cell.centre - low)
    # A rounding more than the voxels need, so that none sticks out.
    cell.half = half * 1.000001
    cell.half2 = wp.dot(cell.half, cell.half)
    return cell


@wp.func
def cell_start(lists: Lists, item: int):
    """The mesh, and the first voxel, of a cell."""
    per_mesh = lists.cells[0] * lists.cells[1] * lists.cells[2]
    index = lists.first + item
    mesh = index / per_mesh
    index = index - mesh * per_mesh
    k = index % lists.cells[2]
    rest = index / lists.cells[2]
    return mesh, CELL * wp.vec3i(rest / lists.cells[1], rest % lists.cells[1], k)


@wp.func
def greedy_leaf(tree: Tree, mesh: int, p: wp.vec3):
    """A leaf near p: always the nearer child. Its triangles give a first bound."""
    base = mesh * (2 << tree.depth)
    node = int(1)
    for _level in range(tree.depth):
        left = base + 2 * node
        left2 = box_distance2(p, tree.low[left], tree.high[left])
        right2 = box_distance2(p, tree.low[left + 1], tree.high[left + 1])
        node = 2 * node + wp.where(right2 < left2, 1, 0)
    return node - (1 << tree.depth)


@wp.func
def probe_direction(probe: int):
    """Directions spread evenly over the sphere (a Fibonacci lattice)."""
    turn = 2.399963 * float(probe)
    z = 1.0 - (2.0 * float(probe % PROBES) + 1.0) / float(PROBES)
    r = wp.sqrt(1.0 - z * z)
    return wp.vec3(r * wp.cos(turn), r * wp.sin(turn), z)


@wp.func
def append(lists: Lists, keep: bool, slot: int, chunk: int, fill: int, lane: int):
    """Add the lanes' slots to a chain; returns its last chunk, how full that is, and how many were added."""
    mask = ballot(keep)
    added = members(mask)
    at = fill + rank(mask, lane)
    fresh = chunk
    if fill + added > _ROOM:
        fresh = fetch_add_once(lists.counts, _NEXT_CHUNK, 1, lane)
        if fresh < lists.chunks and lane == 0:
            lists.pool[chunk * _CHUNK + _ROOM] = fresh
    if keep:
        if at < _ROOM:
            lists.pool[chunk * _CHUNK + at] = slot
        elif fresh < lists.chunks:
            lists.pool[fresh * _CHUNK + at - _ROOM] = slot
    fill = fill + added
    if fill > _ROOM:
        fill = fill - _ROOM
    return fresh, fill, added


@wp.kernel(launch_bounds=(128, BLOCKS))
def _list_cells(
    begin: int,
    lanes: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    parts: Parts,
    slab: Slab,
    lists: Lists,
    stacks: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = (thread / lanes) * _STACK
    leaves = 1 << tree.depth
    item = fetch_add_once(lists.counts, _NEXT_CELL, 1, lane)
    while item < lists.count:
        mesh, start = cell_start(lists, item)
        base = mesh * 2 * leaves
        cell = make_cell(slab, start, CELL, float(tree.frame[mesh * _FRAME_SIZE + _SCALE]))
        known = no_witness()
        # The lanes look for witnesses on all sides: at the centre, then as far from it as the surface is.
        reach = float(0.0)
        probe = lane
        while probe < PROBES + lanes:
            aim = cell.centre + reach * probe_direction(probe)
            leaf = greedy_leaf(tree, mesh, aim)
            for t in range(first_triangle(tree, leaf), first_triangle(tree, leaf + 1)):
                f = load_frame(frames, mesh * tree.count + t)
                known = remember(known, away(f, see(f, cell.centre)))
            known = agree(known, lane)
            reach = wp.sqrt(known.distance2)
            probe = probe + lanes
        chunk = fetch_add_once(lists.counts, _NEXT_CHUNK, 1, lane)
        head = chunk
        fill = int(0)
        length = int(0)
        # The level of the tree that is as wide as the lanes are many is where the descent begins.
        waiting = wp.min(lanes, leaves)
        ripe = int(0)
        if lane < waiting:
            if waiting < leaves:
                stacks[stack + lane] = waiting + lane
            else:
                stacks[stack + _STACK - 1 - lane] = waiting + lane
        if waiting == leaves:
            ripe = waiting
            waiting = int(0)
        wait_for_lanes()
        while waiting + ripe > 0 and chunk < lists.chunks:
            # Inner nodes are taken until the triangles of the leaves that were found fill all lanes.
            if waiting > 0 and ripe * _LEAF < lanes:
                taken = wp.min(lanes, waiting)
                waiting = waiting - taken
                node = int(0)
                if lane < taken:
                    node = stacks[stack + waiting + lane]
                wait_for_lanes()
                for side in range(2):
                    child = 2 * node + side
                    keep = False
                    if node > 0:
                        keep = not box_is_behind(cell, known, tree.low[base + child], tree.high[base + child])
                    is_leaf = keep and child >= leaves
                    keep = keep and child < leaves
                    mask = ballot(keep)
                    if keep:
                        stacks[stack + waiting + rank(mask, lane)] = child
                    waiting = waiting + members(mask)
                    mask = ballot(is_leaf)
                    if is_leaf:
                        stacks[stack + _STACK - 1 - ripe - rank(mask, lane)] = child
                    ripe = ripe + members(mask)
            else:
                taken = wp.min(wp.max(lanes / _LEAF, 1), ripe)
                ripe = ripe - taken
                mine = known
                at = lane
                while at - lane < taken * _LEAF:
                    keep = False
                    slot = int(0)
                    if at < taken * _LEAF:
                        leaf = stacks[stack + _STACK - 1 - ripe - at / _LEAF] - leaves
                        t = first_triangle(tree, leaf) + at % _LEAF
                        if t < first_triangle(tree, leaf + 1):
                            slot = mesh * tree.count + t
                            f = load_frame(frames, slot)
                            seen = see(f, cell.centre)
                            if not triangle_is_behind(cell, known, f, seen):
                                keep = parts_that_matter(cell, tree, parts, slot) != 0
                            mine = remember(mine, away(f, seen))
                    if chunk < lists.chunks:
                        chunk, fill, added = append(lists, keep, slot, chunk, fill, lane)
                        length = length + added
                    at = at + lanes
                known = agree(mine, lane)
            wait_for_lanes()
        if lane == 0:
            lists.heads[item] = wp.where(chunk < lists.chunks, head, -1)
            lists.lengths[item] = length
        item = fetch_add_once(lists.counts, _NEXT_CELL, 1, lane)


def list_cells(
    tree: Tree,
    frames: wp.array,
    parts: Parts,
    slab: Slab,
    lists: Lists,
    stacks: wp.array,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Fill the lists of one pass with `workers` groups of lanes; `stacks` (workers * STACK int32) is scratch."""
    launch(_list_cells, workers * lanes, [lanes, tree, frames, parts, slab, lists, stacks], frames.device, smallest=1)
