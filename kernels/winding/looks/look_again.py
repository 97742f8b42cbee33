"""Looks at boxes of 4^3 voxels that others have left in doubt: a group of lanes for each, with small tolerances.

A descent about the voxels that are left gives a field, nodes and caps (`mixed_descent`); all lanes share these voxels,
as few are left of most boxes. It begins with what a descent for the box of 8^3 around has found (`look_around`).
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, tree_of
from sdm.kernels.geometry.voxel_box import box_between
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel, voxel
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import (
    BLOCKS_PER_SM,
    ballot,
    bits_of_lanes,
    least_whole_of_lanes,
    members,
    one_on_cpu,
    rank,
    sum_of_some,
    unknown,
    wait_for_lanes,
)
from sdm.kernels.primitives.shared_stacks import large_stack_of
from sdm.kernels.winding.cap_field import ONE_OVER_FULL, doubt, share_at
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.eight_voxels import place_in_box
from sdm.kernels.winding.looks.look_around import middle_of, number_of_whole
from sdm.kernels.winding.looks.mixed_descent import END, NODES, VOXELS, Looked, look_closer
from sdm.kernels.winding.looks.node_sum import node_sum
from sdm.kernels.winding.looks.records import ROW, Records, read_field
from sdm.kernels.winding.near_caps import FULL, UNIT, near_angle
from sdm.kernels.winding.octants import count_bits
from sdm.kernels.winding.settled_boxes import MOST_DOUBT, is_left, is_sure, is_whole, opened

wp.set_module_options({"enable_backward": False})

# Where more is near than there is room for, so many more looks, each with so many times the tolerance.
TRIES, LARGER = 6, 4.0
_BITS = 2


@wp.func
def octant_of(number: int):
    """The octant of a box of 4^3 that its voxel of this number (`place_in_box`) is in."""
    return ((number >> 3) & 4) | ((number >> 2) & 2) | ((number >> 1) & 1)


@wp.func
def settle_voxels(
    found: Looked,
    records: Records,
    slot: int,
    middle: wp.vec3,
    error: float,
    caps: Caps,
    centre: wp.vec3,
    scale: float,
    slab: Slab,
    mesh: int,
    start: wp.vec3i,
    count: int,
    stack: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open the listed voxels that what a descent has found leaves in no doubt; the octants that hold others.

    If there is a record it has the field about `middle` of what the descent began without, all but its value.
    """
    undone = int(0)
    base = tree_of(caps.tree, mesh).root
    done = int(0)
    while done < count:
        # As many lanes for each voxel as there are for each that is left.
        parts = int(1)
        while parts < lanes and parts < count - done:
            parts = 2 * parts
        parts = one_on_cpu(parts)
        part = one_on_cpu(lanes / parts)
        mine = done + lane / part
        idle = mine >= count
        number = stack[VOXELS + wp.min(mine, count - 1)]
        v = start + place_in_box(number, _BITS)
        whole = values[mesh, v[0], v[1], v[2]]
        p = scale * voxel(slab_of(slab, mesh), v[0], v[1], v[2])
        among = lane & (part - 1)
        angle = node_sum(caps.moments, base, stack, NODES, found.nodes, p, among, part)
        wrong = float(0.0)
        if found.caps > 0:
            exact, wrong = near_angle(caps, found.caps, not idle, p, stack, END - found.caps, among, part, lanes)
            angle = angle + exact
        angle = sum_of_some(angle, part)
        wrong = sum_of_some(wrong, part) + 2.0 * UNIT * FULL
        winding = whole - angle * ONE_OVER_FULL - share_at(found.field, p - centre)
        if slot >= 0:
            around = read_field(records, slot)
            around.value = wp.float64(0.0)
            winding = winding - share_at(around, p - middle)
        # All have read the whole number before it goes.
        wait_for_lanes()
        if not idle:
            if not is_sure(winding, whole, error + wrong * ONE_OVER_FULL):
                undone = undone | (1 << octant_of(number))
            elif among == 0:
                values[mesh, v[0], v[1], v[2]] = opened(winding)
        done = done + parts
    return bits_of_lanes(undone)


@wp.func
def list_voxels(
    voxels: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    length: int,
    mesh: int,
    start: wp.vec3i,
    count: int,
    shape: wp.vec3i,
    stack: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """List the voxels of a box's list that are not open yet; the octants of those for which there is no room."""
    undone = int(0)
    k = lane
    while k < count:
        number = stack[VOXELS + k]
        v = start + place_in_box(number, _BITS)
        if is_whole(values[mesh, v[0], v[1], v[2]]):
            place = fetch_add(counts, length, 1)
            if place < voxels.shape[0]:
                voxels[place] = ((mesh * shape[0] + v[0]) * shape[1] + v[1]) * shape[2] + v[2]
            else:
                undone = undone | (1 << octant_of(number))
        k = k + lanes
    return bits_of_lanes(undone)


def _look_again_kernel(begins_around: int) -> Any:
    # Whoever needs one of them compiles no other.
    @wp.kernel(launch_bounds=(128, BLOCKS_PER_SM), enable_backward=False, module="unique")
    def look_again(
        begin: int,
        caps: Caps,
        slab: Slab,
        tolerance: float,
        room: int,
        cells: wp.vec3i,
        length: int,
        next_item: int,
        looked: int,
        length_left: int,
        length_voxels: int,
        last: int,
        wholes: wp.vec3i,
        slots: wp.array(dtype=wp.int32),
        records: Records,
        boxes: wp.array(dtype=wp.int32),
        octants: wp.array(dtype=wp.int32),
        left: wp.array(dtype=wp.int32),
        left_octants: wp.array(dtype=wp.int32),
        voxels: wp.array(dtype=wp.int32),
        counts: wp.array(dtype=wp.int32),
        stacks: wp.array(dtype=wp.int32),
        lanes: int,
        values: wp.array4d(dtype=wp.float32),
    ):
        """Open what is left in listed octants of boxes of 4^3 voxels; list what is left in doubt, and with which
        octants.

        The last of these looks lists voxels instead, as long as there is room. `length`, `next_item`, `looked`, if it
        is not negative, `length_left` and `length_voxels` are places of the counts. `slots` tells for the boxes of 8^3,
        so many along each axis (`wholes`), which record is theirs, plus one; without one a descent begins at the root.
        """
        thread = begin + wp.tid()
        lane = thread % lanes
        stack = large_stack_of(stacks, thread / lanes)
        item = fetch_add_once(counts, next_item, 1, lane)
        while item < counts[length]:
            mesh, at = unravel(boxes[item], cells)
            some = octants[item]
            start = wp.vec3i(at[0] << _BITS, at[1] << _BITS, at[2] << _BITS)
            scale = float(caps.tree.frame[mesh * FRAME_SIZE + SCALE])
            here = slab_of(slab, mesh)
            # The voxels that are left, and the least box around them.
            low = wp.vec3i(3, 3, 3)
            high = wp.vec3i(0, 0, 0)
            count = int(0)
            for turn in range(unknown((1 << (3 * _BITS)) / lanes)):
                number = turn * lanes + lane
                inner = place_in_box(number, _BITS)
                open_yet = (some >> octant_of(number)) & 1 != 0 and is_left(slab, values, mesh, start + inner)
                mask = ballot(open_yet)
                if open_yet:
                    low = wp.min(low, inner)
                    high = wp.max(high, inner)
                    stack[VOXELS + count + rank(mask, lane)] = number
                count = count + members(mask)
            for axis in range(3):
                low[axis] = least_whole_of_lanes(low[axis])
                high[axis] = -least_whole_of_lanes(-high[axis])
            if count > 0:
                box = box_between(here, start + low, start + high, scale)
                slot = int(-1)
                handed = int(-1)
                place_of_handed = int(0)
                middle = wp.vec3()
                if begins_around != 0:
                    slot = slots[number_of_whole(mesh, at, wholes)] - 1
                if slot >= 0:
                    handed = records.rows[ROW * slot + 1]
                    place_of_handed = records.rows[ROW * slot + 2]
                    middle = middle_of(records, slot)
                found = Looked()
                found.field.error = float(wp.inf)
                limit = tolerance
                tries = int(0)
                while tries < TRIES and not found.field.error < wp.inf:
                    found = look_closer(
                        caps, mesh, box.centre, wp.sqrt(box.half2), limit, room, records.near, place_of_handed, handed,
                        begins_around == 0, False, stack, lane, lanes,
                    )  # fmt: skip
                    limit = limit * LARGER
                    tries = tries + 1
                error = doubt(found.field)
                if slot >= 0:
                    around = read_field(records, slot)
                    found.field.value = found.field.value + around.value
                    error = error + doubt(around)
                undone = some
                if error < MOST_DOUBT:
                    undone = settle_voxels(
                        found, records, slot, middle, error, caps, box.centre, scale, slab, mesh, start, count, stack,
                        lane, lanes, values,
                    )  # fmt: skip
                # All see what was written.
                wait_for_lanes()
                if last != 0 and undone != 0:
                    undone = list_voxels(
                        voxels, counts, length_voxels, mesh, start, count, slab.shape, stack, lane, lanes, values
                    )
                if lane == 0:
                    if looked >= 0:
                        fetch_add(counts, looked, count_bits(some))
                    if undone != 0:
                        place = fetch_add(counts, length_left, 1)
                        left[place] = boxes[item]
                        left_octants[place] = undone
            # All have read the lists before others take their place.
            wait_for_lanes()
            item = fetch_add_once(counts, next_item, 1, lane)

    return look_again


# By descents that begin at the root, and by those that begin with what the box around has found.
LOOK_AGAIN = [_look_again_kernel(0), _look_again_kernel(1)]
