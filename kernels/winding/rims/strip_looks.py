"""Boxes of voxels among boundary edges: what each is near, and the voxels that it opens.

A box has the boundary's share at its centre, by the sum over all edges, polynomials of the edges that are far for its
size, and a list of those that are near, which are added for each voxel (`radial_strips`). These are two kernels, as
what one of them wants in registers, and in the cache for instructions, the other does not.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.voxel_box import box_of_voxels, is_within, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel, voxel
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import (
    ballot,
    bits_of_lanes,
    members,
    on_cpu,
    rank,
    sum_of_lanes,
    wait_for_lanes,
)
from sdm.kernels.primitives.shared_stacks import LARGE_STACK, LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.boundary_term import Boundary, edges_of
from sdm.kernels.winding.cap_field import Field, doubt, most_change, share_at
from sdm.kernels.winding.eight_voxels import place_in_box
from sdm.kernels.winding.looks.records import ROW, Records, read_field, write_field
from sdm.kernels.winding.looks.settle_boxes import whole_at
from sdm.kernels.winding.near_caps import FULL, UNIT
from sdm.kernels.winding.rims.radial_strips import (
    ACROSS_BOX,
    CUBES,
    DRIFT,
    ERROR,
    NEAR,
    PRODUCTS,
    SHARE,
    SHARE_ERROR,
    SLOPE,
    SQUARES,
    STEPS,
    VOXELS,
    Eight,
    Look,
    Sixteen,
    look_at_edges,
    strips_at,
)
from sdm.kernels.winding.settled_boxes import MOST_DOUBT, is_sure, is_whole, opened

wp.set_module_options({"enable_backward": False})

# Room in a stack for the edges that are near, and behind them for those whose strips lie across a box.
ROOM = {"cuda": 1152, "cpu": 3072}
_ROOM_ON_GPU, _ROOM_ON_CPU = ROOM["cuda"], ROOM["cpu"]
_TOGETHER_ON_GPU, _TOGETHER_ON_CPU = VOXELS["cuda"], VOXELS["cpu"]
# Where in a box the way to its voxels begins, in half-widths: in its middle, but not on any plane that a mesh may have.
ASIDE = wp.constant(wp.vec3(2.7e-3, -3.1e-3, 1.9e-3))
WIDER = 1.004
# Thread blocks, of 128 threads, that a multiprocessor holds at a time: one kernel, then the other.
SEERS, SETTLERS = 5, 4


@wp.func
def field_of(look: Look, lanes: int):
    """The field that all lanes have found together: that of the boundary's share, without what is near."""
    field = Field()
    field.value = wp.float64(FULL * sum_of_lanes(look[SHARE]))
    for axis in range(3):
        field.slope[axis] = sum_of_lanes(look[SLOPE + axis])
        field.squares[axis] = sum_of_lanes(look[SQUARES + axis])
        field.products[axis] = sum_of_lanes(look[PRODUCTS + axis])
    for number in range(7):
        field.cubes[number] = sum_of_lanes(look[CUBES + number])
    # Sums of so many numbers in a row, and of lanes.
    field.drift = sum_of_lanes(look[DRIFT])
    steps = sum_of_lanes(look[STEPS])
    field.error = sum_of_lanes(look[ERROR]) + 4.0 * UNIT * (steps + 14.0) * field.drift
    error = sum_of_lanes(look[SHARE_ERROR]) + 8.0 * UNIT * (1.0 + wp.abs(float(field.value)))
    field.error = field.error + FULL * error
    return field


@wp.func
def centre_of(tree: Tree, slab: Slab, bits: int, cells: wp.vec3i, number: int):
    """The mesh of a box, whence in it the ways to its voxels begin (scaled), and half-widths around that."""
    mesh, at = unravel(number, cells)
    start = wp.vec3i(at[0] << bits, at[1] << bits, at[2] << bits)
    box = box_of_voxels(slab_of(slab, mesh), start, 1 << bits, float(tree.frame[mesh * FRAME_SIZE + SCALE]))
    return mesh, box.centre + wp.cw_mul(ASIDE, box.half), WIDER * box.half


@wp.func
def some_of(counts: wp.array(dtype=wp.int32), listed: int, first: int, last: int):
    """Number of boxes from the first one to before the last one: if they are listed, of those in the list,
    whose length is counted at a place.
    """
    most = last
    if listed >= 0:
        most = wp.min(last, counts[listed])
    return most - first


@wp.func
def halves(length: int, size: int):
    """Boxes of 2^size voxels along an axis of so many."""
    return ((length - 1) >> size) + 1


@wp.func
def box_at(boxes: wp.array(dtype=wp.int32), listed: int, number: int):
    """The number of a box that may be listed."""
    box = number
    if listed >= 0:
        box = boxes[number]
    return box


@wp.kernel(launch_bounds=(128, SEERS), enable_backward=False, module="unique")
def see_strips(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    times: wp.array(dtype=wp.int32),
    slab: Slab,
    bits: int,
    tolerance: float,
    most_near: int,
    cells: wp.vec3i,
    boxes: wp.array(dtype=wp.int32),
    listed: int,
    first: int,
    last: int,
    records: Records,
    next_item: int,
    recorded: int,
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    lanes: int,
):
    """Record what boxes of 2^bits voxels along each edge, `cells` along each axis, are near, and the field of the rest.

    From the first box to before the last one, of all, or of those in a list (`some_of`). Each edge counts `times` times
    (`edges_once`). Boxes of which too little is known, or to which more than `most_near` edges are near, have a
    negative number of these. `next_item` and `recorded` are places of the counts: of boxes, and of near edges.
    """
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = large_stack_of(stacks, thread / lanes)
    room = wp.where(on_cpu(), _ROOM_ON_CPU, _ROOM_ON_GPU)
    room_across = wp.where(on_cpu(), LARGE_STACK_ON_CPU - _ROOM_ON_CPU, LARGE_STACK - _ROOM_ON_GPU)
    total = some_of(counts, listed, first, last)
    often = float(times[0])
    slot = fetch_add_once(counts, next_item, 1, lane)
    while slot < total:
        mesh, c, half = centre_of(tree, slab, bits, cells, box_at(boxes, listed, first + slot))
        look = look_at_edges(
            boundary.ends, mesh * boundary.count, edges_of(boundary), c, wp.length(half), half, tolerance / often,
            stack, 0, room, room, room_across, lane, lanes,
        )  # fmt: skip
        for k in range(STEPS):
            if k != NEAR and k != ACROSS_BOX:
                look[k] = often * look[k]
        field = field_of(look, lanes)
        near = int(look[NEAR])
        across = int(look[ACROSS_BOX])
        place = int(0)
        if near > wp.min(room, most_near) or across > room_across or not doubt(field) < MOST_DOUBT:
            near = int(-1)
        else:
            place = fetch_add_once(counts, recorded, near + across, lane)
            if place + near + across > records.near.shape[0]:
                near = int(-1)
        wait_for_lanes()
        if lane == 0:
            write_field(records, slot, field)
            records.rows[ROW * slot] = near
            records.rows[ROW * slot + 1] = across
            records.rows[ROW * slot + 2] = place
        if near >= 0:
            i = lane
            while i < near + across:
                records.near[place + i] = stack[wp.where(i < near, i, room + i - near)]
                i = i + lanes
        # All have read the lists before others take their place.
        wait_for_lanes()
        slot = fetch_add_once(counts, next_item, 1, lane)


@wp.kernel(launch_bounds=(128, SETTLERS), enable_backward=False, module="unique")
def settle_strips(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    times: wp.array(dtype=wp.int32),
    slab: Slab,
    bits: int,
    parted: int,
    cells: wp.vec3i,
    boxes: wp.array(dtype=wp.int32),
    listed: int,
    first: int,
    last: int,
    records: Records,
    left: wp.array(dtype=wp.int32),
    left_octants: wp.array(dtype=wp.int32),
    voxels: wp.array(dtype=wp.int32),
    next_item: int,
    looked: int,
    length: int,
    length_voxels: int,
    counts: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open the voxels of recorded boxes; list those that are left in doubt, and of those for which there is no room the
    boxes, and their octants.

    If `parted` is 1, boxes are opened octant by octant, and octants that leave some in doubt are listed alone, as boxes
    of half the size. `next_item`, `looked`, `length` and `length_voxels` are places of the counts.
    """
    lane = (begin + wp.tid()) % lanes
    together = wp.where(on_cpu(), _TOGETHER_ON_CPU, _TOGETHER_ON_GPU)
    at_once = together * lanes
    size = bits - parted
    shares = wp.where(parted != 0, 8, 1)
    total = some_of(counts, listed, first, last) * shares
    item = fetch_add_once(counts, next_item, 1, lane)
    while item < total:
        slot = item / shares
        octant = item - slot * shares
        box = box_at(boxes, listed, first + slot)
        mesh, c, half = centre_of(tree, slab, bits, cells, box)
        _mesh, at = unravel(box, cells)
        here = slab_of(slab, mesh)
        if parted != 0:
            at = 2 * at + octant_at(octant)
            box = ((mesh * halves(slab.shape[0], size) + at[0]) * halves(slab.shape[1], size) + at[1]) * halves(
                slab.shape[2], size
            ) + at[2]
        start = wp.vec3i(at[0] << size, at[1] << size, at[2] << size)
        scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
        near = records.rows[ROW * slot]
        across = records.rows[ROW * slot + 1]
        place = records.rows[ROW * slot + 2]
        plain = bool(False)
        middle = float(0.0)
        change = float(0.0)
        error = float(wp.inf)
        if near >= 0:
            seen = read_field(records, slot)
            change = most_change(seen, half)
            error = doubt(seen)
            middle = float(seen.value) / FULL
            plain = near + across == 0 and is_sure(middle - wp.floor(middle), 1.0, error + change)
        undone = int(0)
        number_first = int(0)
        if near < 0 and parted != 0:
            # Smaller boxes look at all voxels.
            undone = int(255)
            number_first = 1 << (3 * size)
        while number_first < 1 << (3 * size):
            xs = Eight()
            ys = Eight()
            zs = Eight()
            wholes = Eight()
            for k in range(8):
                wholes[k] = float(0.5)
                number = number_first + wp.where(on_cpu(), k, k * lanes + lane)
                if k < together and number < 1 << (3 * size):
                    v = start + place_in_box(number, size)
                    p = scale * voxel(here, v[0], v[1], v[2])
                    xs[k] = p[0]
                    ys[k] = p[1]
                    zs[k] = p[2]
                    wholes[k] = whole_at(slab, values, mesh, v)
            found = Sixteen()
            if near >= 0 and near + across > 0:
                found = strips_at(
                    boundary.ends, records.near, place, near, place + near, across, c, wp.length(half), xs, ys, zs
                )
            # Once more, as registers are few.
            field = read_field(records, slot)
            often = float(times[0])
            for k in range(8):
                if k < together:
                    whole = wholes[k]
                    number = number_first + wp.where(on_cpu(), k, k * lanes + lane)
                    v = start + place_in_box(number, size)
                    unsure = bool(False)
                    if is_whole(whole):
                        share = middle
                        wrong = error + change
                        if not plain:
                            share = share_at(field, wp.vec3(xs[k], ys[k], zs[k]) - c) + often * found[k]
                            wrong = error + often * found[8 + k]
                        unsure = not is_sure(whole + share, whole, wrong)
                        if not unsure:
                            values[mesh, v[0], v[1], v[2]] = opened(whole + share)
                    mask = ballot(unsure)
                    if mask != wp.uint32(0):
                        free = int(0)
                        if parted == 0:
                            free = fetch_add_once(counts, length_voxels, members(mask), lane) + rank(mask, lane)
                        if unsure and parted == 0 and free < voxels.shape[0]:
                            voxels[free] = ((mesh * slab.shape[0] + v[0]) * slab.shape[1] + v[1]) * slab.shape[2] + v[2]
                        elif unsure:
                            inner = place_in_box(number, size)
                            h = size - 1
                            undone = undone | (1 << (4 * (inner[0] >> h) + 2 * (inner[1] >> h) + (inner[2] >> h)))
            number_first = number_first + at_once
        undone = bits_of_lanes(undone)
        if lane == 0 and is_within(slab, start):
            if octant == 0:
                fetch_add(counts, looked, 1)
            if undone != 0:
                free = fetch_add(counts, length, 1)
                left[free] = box
                left_octants[free] = undone
        item = fetch_add_once(counts, next_item, 1, lane)
