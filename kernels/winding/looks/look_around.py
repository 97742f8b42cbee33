"""Looks at boxes of 8^3 voxels of which some of 4^3 are in doubt: what all of these have in common, by one descent.

A box of 4^3 looks at thousands of nodes with a small tolerance, and its neighbours at nearly the same ones. What is far
for the voxels that are left of all of them goes into a field, which is recorded with the nodes that are not
(`mixed_descent`): from those the smaller boxes' own descents begin (`look_again`).
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE
from sdm.kernels.geometry.voxel_box import box_between, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, least_whole_of_lanes, unknown, wait_for_lanes
from sdm.kernels.primitives.shared_stacks import large_stack_of
from sdm.kernels.primitives.vector_loads import load4, write4
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.eight_voxels import place_in_box
from sdm.kernels.winding.looks.mixed_descent import NODES, ROOM, look_closer
from sdm.kernels.winding.looks.records import ROW, Records, write_field
from sdm.kernels.winding.octants import is_one
from sdm.kernels.winding.settled_boxes import is_left

wp.set_module_options({"enable_backward": False})

# Bits of the size of the smaller boxes, and of their voxels' numbers.
_BITS, _INNER = 2, 6


@wp.func
def number_of_whole(mesh: int, at: wp.vec3i, wholes: wp.vec3i):
    """The number of the box of twice the size, so many along each axis, that a box is in."""
    return ((mesh * wholes[0] + (at[0] >> 1)) * wholes[1] + (at[1] >> 1)) * wholes[2] + (at[2] >> 1)


@wp.func
def middle_of(records: Records, slot: int):
    """The point that a recorded field is about."""
    r = load4(records.middles, slot)
    return wp.vec3(r[0], r[1], r[2])


@wp.kernel
def list_wholes(
    begin: int,
    workers: int,
    cells: wp.vec3i,
    wholes: wp.vec3i,
    length: int,
    length_wholes: int,
    boxes: wp.array(dtype=wp.int32),
    listed: wp.array(dtype=wp.int32),
    parts: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
):
    """List the boxes of twice the size that listed boxes are in, and which of their octants these are, by the number of
    the larger box. `length` and `length_wholes` are places of the counts.
    """
    i = begin + wp.tid()
    while i < counts[length]:
        mesh, at = unravel(boxes[i], cells)
        octant = 4 * (at[0] & 1) + 2 * (at[1] & 1) + (at[2] & 1)
        whole = number_of_whole(mesh, at, wholes)
        # Each box is listed once.
        if fetch_add(parts, whole, 1 << octant) == 0:
            listed[fetch_add(counts, length_wholes, 1)] = whole
        i = i + workers


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM))
def look_around(
    begin: int,
    caps: Caps,
    slab: Slab,
    tolerance: float,
    room: int,
    wholes: wp.vec3i,
    length: int,
    next_item: int,
    recorded: int,
    recorded_near: int,
    listed: wp.array(dtype=wp.int32),
    parts: wp.array(dtype=wp.int32),
    records: Records,
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Record field and near nodes of listed boxes of 8^3 voxels; the number of the record, plus one, takes the place of
    the octants, or none where a box has no record, as there is one octant alone, or no room.

    `length`, `next_item`, `recorded` and `recorded_near` are places of the counts.
    """
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = large_stack_of(stacks, thread / lanes)
    item = fetch_add_once(counts, next_item, 1, lane)
    while item < counts[length]:
        here = listed[item]
        mesh, at = unravel(here, wholes)
        some = parts[here]
        slot = int(-1)
        if not is_one(some):
            start = wp.vec3i(at[0] << (_BITS + 1), at[1] << (_BITS + 1), at[2] << (_BITS + 1))
            # The least box around the voxels that are left.
            low = wp.vec3i(7, 7, 7)
            high = wp.vec3i(0, 0, 0)
            for turn in range(unknown((8 << _INNER) / lanes)):
                number = turn * lanes + lane
                inner = place_in_box(number & ((1 << _INNER) - 1), _BITS) + (1 << _BITS) * octant_at(number >> _INNER)
                if (some >> (number >> _INNER)) & 1 != 0 and is_left(slab, values, mesh, start + inner):
                    low = wp.min(low, inner)
                    high = wp.max(high, inner)
            for axis in range(3):
                low[axis] = least_whole_of_lanes(low[axis])
                high[axis] = -least_whole_of_lanes(-high[axis])
            scale = float(caps.tree.frame[mesh * FRAME_SIZE + SCALE])
            if low[0] <= high[0]:
                box = box_between(slab_of(slab, mesh), start + low, start + high, scale)
                found = look_closer(
                    caps, mesh, box.centre, wp.sqrt(box.half2), tolerance, wp.min(room, ROOM), listed, 0, -1, True,
                    True, stack, lane, lanes,
                )  # fmt: skip
                if found.field.error < wp.inf:
                    slot = fetch_add_once(counts, recorded, 1, lane)
                    place = fetch_add_once(counts, recorded_near, found.nodes, lane)
                    if slot >= records.rows.shape[0] / ROW or place + found.nodes > records.near.shape[0]:
                        slot = int(-1)
                    else:
                        if lane == 0:
                            write_field(records, slot, found.field)
                            records.rows[ROW * slot + 1] = found.nodes
                            records.rows[ROW * slot + 2] = place
                            write4(records.middles, slot, box.centre[0], box.centre[1], box.centre[2], 0.0)
                        i = lane
                        while i < found.nodes:
                            records.near[place + i] = stack[NODES + i]
                            i = i + lanes
        # All have read which octants there are, and the lists.
        wait_for_lanes()
        if lane == 0:
            parts[here] = slot + 1
        item = fetch_add_once(counts, next_item, 1, lane)
