"""Second stage of the dense query: bricks of 4^3 voxels, and the distances themselves.

One group of lanes takes one brick. It filters the list of the brick's cell once more, for the brick alone, and
measures the brick's voxels from the triangles that are left.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cells import CHUNK, NEXT_BRICK, ROOM, Lists, cell_start, make_cell
from sdm.kernels.closest import nearest_slot
from sdm.kernels.cull import Cell, agree, away, no_witness, remember, triangle_is_behind
from sdm.kernels.frames import exact_distance, exact_place, frame_distance2, load_frame, see
from sdm.kernels.grid import Output, Slab, voxel, write_distance
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

BRICK = wp.constant(4)
# Places for the list of a brick. A longer one is not worth it: the brick's voxels are then searched one by one.
SCRATCH = 4096

_CHUNK = wp.constant(CHUNK)
_ROOM = wp.constant(ROOM)
_NEXT_BRICK = wp.constant(NEXT_BRICK)
_SCRATCH = wp.constant(SCRATCH)
_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
_UNSCALE = wp.constant(UNSCALE)


@wp.func
def filter_chain(
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    lists: Lists,
    item: int,
    cell: Cell,
    kept: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.vec3),
    at: int,
    lane: int,
    lanes: int,
):
    """Write the entries of a cell's list that matter to its brick `cell` at kept[at...]; returns how many there are.

    With each goes the brick's centre in the triangle's frame, to float32's last bit: a voxel is measured from there, so
    that its distance to a far corner costs no accuracy. More than SCRATCH are counted but not written.
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
            turn = int(0)
            if i < taken:
                slot = lists.pool[chunk * _CHUNK + i]
                f = load_frame(frames, slot)
                turn = f.turn
                keep = not triangle_is_behind(cell, known, f, see(f, cell.centre))
            mask = ballot(keep)
            place = total + rank(mask, lane)
            if keep and place < _SCRATCH:
                kept[at + place] = slot
                places[at + place] = exact_place(tree, slot, turn, wp.vec3d(cell.centre))
            total = total + members(mask)
            start = start + lanes
        left = left - taken
        if left > 0:
            chunk = lists.pool[chunk * _CHUNK + _ROOM]
    return total


@wp.func
def measure_brick(
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    slab: Slab,
    out: Output,
    mesh: int,
    start: wp.vec3i,
    centre: wp.vec3,
    kept: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.vec3),
    at: int,
    length: int,
    lane: int,
    lanes: int,
):
    """Distances of the 4^3 voxels from `start` to the triangles at kept[at...]; returns the unclear ones."""
    scale = tree.frame[mesh * _FRAME_SIZE + _SCALE]
    unscale = tree.frame[mesh * _FRAME_SIZE + _UNSCALE]
    unclear = int(0)
    # Two voxels at a time, two layers apart: each triangle is loaded once for both.
    v = lane
    while v < 32:
        i = start[0] + (v >> 4)
        j = start[1] + ((v >> 2) & 3)
        k = start[2] + (v & 3)
        p_exact = scale * wp.vec3d(voxel(slab, i, j, k))
        q_exact = scale * wp.vec3d(voxel(slab, i + 2, j, k))
        p = wp.vec3(p_exact - wp.vec3d(centre))
        q = wp.vec3(q_exact - wp.vec3d(centre))
        p2 = float(wp.inf)
        q2 = float(wp.inf)
        # Some triangle is taken even where float32 overflows.
        p_slot = int(kept[at])
        q_slot = int(kept[at])
        for entry in range(length):
            slot = kept[at + entry]
            f = load_frame(frames, slot)
            o = places[at + entry]
            d2 = frame_distance2(f, o[0] + wp.dot(p, f.x_axis), o[1] + wp.dot(p, f.y_axis), o[2] + wp.dot(p, f.normal))
            if d2 < p2:
                p2 = d2
                p_slot = slot
            d2 = frame_distance2(f, o[0] + wp.dot(q, f.x_axis), o[1] + wp.dot(q, f.y_axis), o[2] + wp.dot(q, f.normal))
            if d2 < q2:
                q2 = d2
                q_slot = slot
        if j < slab.shape[1] and k < slab.shape[2]:
            if i < slab.shape[0]:
                unclear = unclear + write_distance(
                    out, mesh, i, j, k, unscale * exact_distance(tree, p_slot, load_frame(frames, p_slot), p_exact)
                )
            if i + 2 < slab.shape[0]:
                unclear = unclear + write_distance(
                    out, mesh, i + 2, j, k, unscale * exact_distance(tree, q_slot, load_frame(frames, q_slot), q_exact)
                )
        v = v + lanes
    return unclear


@wp.func
def search_brick(
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    slab: Slab,
    out: Output,
    mesh: int,
    start: wp.vec3i,
    lane: int,
    lanes: int,
):
    """Distances of the 4^3 voxels from `start` by one search of the tree for each; returns the unclear ones."""
    scale = tree.frame[mesh * _FRAME_SIZE + _SCALE]
    unscale = tree.frame[mesh * _FRAME_SIZE + _UNSCALE]
    unclear = int(0)
    guess = mesh * tree.count
    v = lane
    while v < 64:
        i = start[0] + (v >> 4)
        j = start[1] + ((v >> 2) & 3)
        k = start[2] + (v & 3)
        if i < slab.shape[0] and j < slab.shape[1] and k < slab.shape[2]:
            p = scale * wp.vec3d(voxel(slab, i, j, k))
            guess = nearest_slot(tree, mesh, wp.vec3(p), guess)
            unclear = unclear + write_distance(
                out, mesh, i, j, k, unscale * exact_distance(tree, guess, load_frame(frames, guess), p)
            )
        v = v + lanes
    return unclear


@wp.kernel
def _measure_bricks(
    begin: int,
    lanes: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    slab: Slab,
    lists: Lists,
    scratch: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.vec3),
    out: Output,
):
    thread = begin + wp.tid()
    lane = thread % lanes
    kept = (thread / lanes) * _SCRATCH
    # Eight bricks to a cell.
    item = fetch_add_once(lists.counts, _NEXT_BRICK, 1, lane)
    while item < 8 * lists.count:
        mesh, start = cell_start(lists, item / 8)
        start = start + BRICK * wp.vec3i((item >> 2) & 1, (item >> 1) & 1, item & 1)
        if start[0] < slab.shape[0] and start[1] < slab.shape[1] and start[2] < slab.shape[2]:
            few = int(0)
            brick = make_cell(slab, start, BRICK, float(tree.frame[mesh * _FRAME_SIZE + _SCALE]))
            if lists.heads[item / 8] >= 0:
                few = filter_chain(tree, frames, lists, item / 8, brick, scratch, places, kept, lane, lanes)
                wait_for_lanes()
            unclear = int(0)
            # No list is ever empty; but were one to be, the tree still has the answer.
            if few == 0 or few > _SCRATCH:
                unclear = search_brick(tree, frames, slab, out, mesh, start, lane, lanes)
            else:
                unclear = measure_brick(
                    tree, frames, slab, out, mesh, start, brick.centre, scratch, places, kept, few, lane, lanes
                )
            wait_for_lanes()
            if unclear > 0:
                fetch_add(out.ambiguous, mesh, unclear)
        item = fetch_add_once(lists.counts, _NEXT_BRICK, 1, lane)


def measure_bricks(
    tree: Tree,
    frames: wp.array,
    slab: Slab,
    lists: Lists,
    scratch: wp.array,
    places: wp.array,
    out: Output,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Distances of every voxel of one pass; `scratch` is (workers * SCRATCH) int32, `places` as many vec3."""
    launch(
        _measure_bricks,
        workers * lanes,
        [lanes, tree, frames, slab, lists, scratch, places, out],
        frames.device,
        smallest=1,
    )
