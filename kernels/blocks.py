"""Second stage of the dense query: blocks of 8^3 voxels, their bricks of 4^3, and the distances themselves.

One group of lanes takes one block. It filters the coarse cell's list for the block, the block's for each brick, and
measures the brick's voxels from the triangles that are left.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cells import CHUNK, NEXT_BLOCK, ROOM, Lists, cell_start, make_cell
from sdm.kernels.closest import nearest_slot, slot_distance2
from sdm.kernels.cull import Cell, agree, away, no_witness, remember, triangle_is_behind
from sdm.kernels.frames import frame_distance2, load_frame, see
from sdm.kernels.grid import Slab, voxel
from sdm.kernels.lanes import (
    ballot,
    fetch_add,
    fetch_add_once,
    members,
    rank,
    wait_for_lanes,
)
from sdm.kernels.tree import FRAME_SIZE, SCALE, UNSCALE, Tree

wp.set_module_options({"enable_backward": False})

# Places in a group's scratch: the block's list, then the brick's.
BLOCK_ROOM = 4096
BRICK_ROOM = 2048
SCRATCH = BLOCK_ROOM + BRICK_ROOM

_CHUNK = wp.constant(CHUNK)
_ROOM = wp.constant(ROOM)
_NEXT_BLOCK = wp.constant(NEXT_BLOCK)
_BLOCK_ROOM = wp.constant(BLOCK_ROOM)
_BRICK_ROOM = wp.constant(BRICK_ROOM)
_SCRATCH = wp.constant(SCRATCH)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
_UNSCALE = wp.constant(UNSCALE)


@wp.struct
class Output:
    """Where distances go: the values hold winding numbers before."""

    values: wp.array4d(dtype=wp.float32)
    ambiguous: wp.array(dtype=wp.int32)


@wp.func
def write_distance(out: Output, mesh: int, i: int, j: int, k: int, distance: float):
    """Replace a voxel's winding number by its signed distance; 1 if the winding number was unclear."""
    winding = out.values[mesh, i, j, k]
    out.values[mesh, i, j, k] = wp.where(winding > 0.5, -distance, distance)
    return wp.where(wp.abs(winding - 0.5) < 0.25, 1, 0)


@wp.func
def filter_chain(
    frames: wp.array(dtype=wp.float32),
    lists: Lists,
    item: int,
    cell: Cell,
    kept: wp.array(dtype=wp.int32),
    at: int,
    room: int,
    lane: int,
    lanes: int,
):
    """Write the entries of a coarse cell's list that matter to `cell` at kept[at...]; returns how many there are.

    More than `room` are counted but not written.
    """
    known = no_witness()
    chunk = lists.heads[item]
    left = lists.lengths[item]
    while left > 0:
        taken = wp.min(left, _ROOM)
        i = lane
        while i < taken:
            f = load_frame(frames, lists.pool[chunk * _CHUNK + i])
            known = remember(known, away(f, see(f, cell.centre)))
            i = i + lanes
        left = left - taken
        if left > 0:
            chunk = lists.pool[chunk * _CHUNK + _ROOM]
    known = agree(known, lane)
    total = int(0)
    chunk = lists.heads[item]
    left = lists.lengths[item]
    while left > 0:
        taken = wp.min(left, _ROOM)
        start = int(0)
        while start < taken:
            i = start + lane
            keep = False
            slot = int(0)
            if i < taken:
                slot = lists.pool[chunk * _CHUNK + i]
                f = load_frame(frames, slot)
                keep = not triangle_is_behind(cell, known, f, see(f, cell.centre))
            mask = ballot(keep)
            place = total + rank(mask, lane)
            if keep and place < room:
                kept[at + place] = slot
            total = total + members(mask)
            start = start + lanes
        left = left - taken
        if left > 0:
            chunk = lists.pool[chunk * _CHUNK + _ROOM]
    return total


@wp.func
def filter_list(
    frames: wp.array(dtype=wp.float32),
    kept: wp.array(dtype=wp.int32),
    source: int,
    length: int,
    cell: Cell,
    at: int,
    lane: int,
    lanes: int,
):
    """As `filter_chain`, from the list of `length` entries at kept[source...] and with room for BRICK_ROOM."""
    known = no_witness()
    i = lane
    while i < length:
        f = load_frame(frames, kept[source + i])
        known = remember(known, away(f, see(f, cell.centre)))
        i = i + lanes
    known = agree(known, lane)
    total = int(0)
    start = int(0)
    while start < length:
        i = start + lane
        keep = False
        slot = int(0)
        if i < length:
            slot = kept[source + i]
            f = load_frame(frames, slot)
            keep = not triangle_is_behind(cell, known, f, see(f, cell.centre))
        mask = ballot(keep)
        place = total + rank(mask, lane)
        if keep and place < _BRICK_ROOM:
            kept[at + place] = slot
        total = total + members(mask)
        start = start + lanes
    return total


@wp.func
def measure_brick(
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    slab: Slab,
    out: Output,
    mesh: int,
    start: wp.vec3i,
    kept: wp.array(dtype=wp.int32),
    at: int,
    length: int,
    lane: int,
    lanes: int,
):
    """Distances of the 4^3 voxels from `start` to the triangles at kept[at...]; returns the unclear ones."""
    scale = float(tree.frame[mesh * _FRAME_SIZE + _SCALE])
    unscale = float(tree.frame[mesh * _FRAME_SIZE + _UNSCALE])
    unclear = int(0)
    # Two voxels at a time, two layers apart: each triangle is loaded once for both.
    v = lane
    while v < 32:
        i = start[0] + (v >> 4)
        j = start[1] + ((v >> 2) & 3)
        k = start[2] + (v & 3)
        p = scale * voxel(slab, i, j, k)
        q = scale * voxel(slab, i + 2, j, k)
        p2 = float(wp.inf)
        q2 = float(wp.inf)
        for entry in range(length):
            f = load_frame(frames, kept[at + entry])
            p2 = wp.min(p2, frame_distance2(f, p))
            q2 = wp.min(q2, frame_distance2(f, q))
        if j < slab.shape[1] and k < slab.shape[2]:
            if i < slab.shape[0]:
                unclear = unclear + write_distance(out, mesh, i, j, k, unscale * wp.sqrt(p2))
            if i + 2 < slab.shape[0]:
                unclear = unclear + write_distance(out, mesh, i + 2, j, k, unscale * wp.sqrt(q2))
        v = v + lanes
    return unclear


@wp.func
def search_brick(tree: Tree, slab: Slab, out: Output, mesh: int, start: wp.vec3i, lane: int, lanes: int):
    """Distances of the 4^3 voxels from `start` by one search of the tree for each; returns the unclear ones."""
    scale = float(tree.frame[mesh * _FRAME_SIZE + _SCALE])
    unscale = float(tree.frame[mesh * _FRAME_SIZE + _UNSCALE])
    unclear = int(0)
    guess = mesh * tree.count
    v = lane
    while v < 64:
        i = start[0] + (v >> 4)
        j = start[1] + ((v >> 2) & 3)
        k = start[2] + (v & 3)
        if i < slab.shape[0] and j < slab.shape[1] and k < slab.shape[2]:
            p = scale * voxel(slab, i, j, k)
            guess = nearest_slot(tree, mesh, p, guess)
            unclear = unclear + write_distance(
                out, mesh, i, j, k, unscale * wp.sqrt(slot_distance2(tree, guess, p))
            )
        v = v + lanes
    return unclear


@wp.func
def measure_from_chain(
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    slab: Slab,
    lists: Lists,
    coarse: int,
    out: Output,
    mesh: int,
    start: wp.vec3i,
    scratch: wp.array(dtype=wp.int32),
    at: int,
    lane: int,
    lanes: int,
):
    """Distances of a brick straight from its coarse cell's list, or from the tree if there is none; the unclear ones."""
    few = int(_SCRATCH + 1)
    if lists.heads[coarse] >= 0:
        cell = make_cell(slab, start, 4, float(tree.frame[mesh * _FRAME_SIZE + _SCALE]))
        few = filter_chain(frames, lists, coarse, cell, scratch, at, _SCRATCH, lane, lanes)
        wait_for_lanes()
    if few > _SCRATCH:
        return search_brick(tree, slab, out, mesh, start, lane, lanes)
    return measure_brick(tree, frames, slab, out, mesh, start, scratch, at, few, lane, lanes)


@wp.func
def exists(slab: Slab, start: wp.vec3i):
    """Whether a voxel is in the slab."""
    return start[0] < slab.shape[0] and start[1] < slab.shape[1] and start[2] < slab.shape[2]


@wp.kernel
def _measure_blocks(
    begin: int,
    lanes: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    slab: Slab,
    lists: Lists,
    scratch: wp.array(dtype=wp.int32),
    out: Output,
):
    thread = begin + wp.tid()
    lane = thread % lanes
    block_list = (thread / lanes) * _SCRATCH
    brick_list = block_list + _BLOCK_ROOM
    # Eight items to a coarse cell: its blocks, or its bricks where it is a block itself.
    item = fetch_add_once(lists.counts, _NEXT_BLOCK, 1, lane)
    while item < 8 * lists.count:
        coarse = item / 8
        mesh, start = cell_start(lists, coarse)
        start = start + (lists.size / 2) * wp.vec3i((item >> 2) & 1, (item >> 1) & 1, item & 1)
        if exists(slab, start):
            unclear = int(0)
            if lists.size == 8:
                unclear = measure_from_chain(
                    tree, frames, slab, lists, coarse, out, mesh, start, scratch, block_list, lane, lanes
                )
            else:
                scale = float(tree.frame[mesh * _FRAME_SIZE + _SCALE])
                length = int(_BLOCK_ROOM + 1)
                if lists.heads[coarse] >= 0:
                    cell = make_cell(slab, start, 8, scale)
                    length = filter_chain(
                        frames, lists, coarse, cell, scratch, block_list, _BLOCK_ROOM, lane, lanes
                    )
                    wait_for_lanes()
                for b in range(8):
                    corner = start + 4 * wp.vec3i(b >> 2, (b >> 1) & 1, b & 1)
                    if exists(slab, corner):
                        few = int(_BRICK_ROOM + 1)
                        if length <= _BLOCK_ROOM:
                            brick = make_cell(slab, corner, 4, scale)
                            few = filter_list(frames, scratch, block_list, length, brick, brick_list, lane, lanes)
                            wait_for_lanes()
                        if few <= _BRICK_ROOM:
                            unclear = unclear + measure_brick(
                                tree, frames, slab, out, mesh, corner, scratch, brick_list, few, lane, lanes
                            )
                        elif length <= _BLOCK_ROOM:
                            unclear = unclear + measure_brick(
                                tree, frames, slab, out, mesh, corner, scratch, block_list, length, lane, lanes
                            )
                        else:
                            unclear = unclear + measure_from_chain(
                                tree, frames, slab, lists, coarse, out, mesh, corner, scratch, block_list, lane, lanes
                            )
                        wait_for_lanes()
            if unclear > 0:
                fetch_add(out.ambiguous, mesh, unclear)
        item = fetch_add_once(lists.counts, _NEXT_BLOCK, 1, lane)


def measure_blocks(
    tree: Tree,
    frames: wp.array,
    slab: Slab,
    lists: Lists,
    scratch: wp.array,
    out: Output,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Distances of every voxel of one pass; `scratch` is (workers * SCRATCH) int32."""
    launch(_measure_blocks, workers * lanes, [lanes, tree, frames, slab, lists, scratch, out], frames.device, smallest=1)
