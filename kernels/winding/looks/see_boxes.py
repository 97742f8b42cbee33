"""First looks at boxes of voxels on a GPU, from large ones to small, by descents of the tree of an open mesh's caps.

A box whose whole numbers will do is left as it is; one of which too little is known is left to smaller ones; of the
others field and near caps are recorded, by which `settle_boxes` opens their voxels. These are two kernels, as voxels
and near caps want as many lanes at once as have room, and descents many registers.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE
from sdm.kernels.geometry.voxel_box import box_of_voxels, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import bit_at, on_cpu, one_on_cpu, unknown, wait_for_lanes
from sdm.kernels.primitives.shared_stacks import FIELD_PLACES, LARGE_STACK, LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.cap_descent import see_caps
from sdm.kernels.winding.cap_field import Field, doubt, largest_share, most_change, moved_field
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.looks.box_descent import NEAR_AT, see_box
from sdm.kernels.winding.looks.count_places import (
    LENGTH,
    LOOKED,
    NEXT,
    RECORDED,
    RECORDED_NEAR,
    STRIDE,
)
from sdm.kernels.winding.looks.records import Records, field_at, put_field, put_record
from sdm.kernels.winding.near_caps import WIDER, near_list_of
from sdm.kernels.winding.octants import is_one, octants_to_open, parts_of_lanes
from sdm.kernels.winding.settled_boxes import LARGEST_SHARE, MOST_DOUBT

wp.set_module_options({"enable_backward": False})

# Thread blocks, of 128 threads, that a multiprocessor holds at a time: with four, a fifth of the time goes to registers
# in memory.
BLOCKS = 3
# The place in a stack of the field of a whole box, behind the lists of a descent.
_ON_GPU, _ON_CPU = LARGE_STACK - FIELD_PLACES, LARGE_STACK_ON_CPU - FIELD_PLACES


@wp.func
def parts_beside(octants: int, near: int, lanes: int):
    """Parts of a group that look at octants beside each other."""
    return parts_of_lanes(octants, near, lanes)


@wp.func
def one_part(octants: int, near: int, lanes: int):
    """All of a group's lanes, for one octant after the other."""
    return int(1)


@wp.func
def see_in_parts(
    caps: Caps,
    mesh: int,
    centre: wp.vec3,
    radius: float,
    tolerance: float,
    room: int,
    begin: Field,
    handed: int,
    keep: bool,
    stack: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
    part: int,
    idle: bool,
):
    """`cap_descent.see_caps`, and where it lists near caps."""
    field = see_caps(
        caps, mesh, centre, radius, tolerance, room, begin, handed, keep, True, 0, stack, lane, lanes, part, idle
    )
    return field, near_list_of(lane, part)


@wp.func
def see_by_all(
    caps: Caps,
    mesh: int,
    centre: wp.vec3,
    radius: float,
    tolerance: float,
    room: int,
    begin: Field,
    handed: int,
    keep: bool,
    stack: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
    part: int,
    idle: bool,
):
    """`box_descent.see_box`, and where it lists near caps."""
    field = see_box(caps, mesh, centre, radius, tolerance, room, begin, handed, keep, stack, lane, lanes)
    return field, int(NEAR_AT)


def _see_boxes_kernel(parts_together: Any, descend: Any) -> Any:
    # Whoever needs one of them compiles no other.
    @wp.kernel(launch_bounds=(128, BLOCKS), enable_backward=False, module="unique")
    def see_boxes(
        begin: int,
        caps: Caps,
        slab: Slab,
        bits: int,
        tolerance: float,
        listed: int,
        settled: int,
        parents: wp.vec3i,
        cells: wp.vec3i,
        level: int,
        first: int,
        fewest: int,
        boxes: wp.array(dtype=wp.int32),
        octants: wp.array(dtype=wp.int32),
        left: wp.array(dtype=wp.int32),
        left_octants: wp.array(dtype=wp.int32),
        records: Records,
        counts: wp.array(dtype=wp.int32),
        stacks: wp.array(dtype=wp.int32),
        lanes: int,
        values: wp.array4d(dtype=wp.float32),
    ):
        """Look at octants, of 2^bits voxels along each edge, of boxes.

        One group of lanes descends for a box, and then its parts for its octants from what that has found; unless boxes
        are so few that there would be fewer than `fewest` items of work: then a box is some of them.
        """
        thread = begin + wp.tid()
        lane = thread % lanes
        stack = large_stack_of(stacks, thread / lanes)
        whole_at = wp.where(on_cpu(), _ON_CPU, _ON_GPU)
        total = values.shape[0] * parents[0] * parents[1] * parents[2]
        if first == 0:
            total = counts[STRIDE * level + LENGTH]
        pieces = int(1)
        while pieces < 8 and total * pieces < fewest:
            pieces = 2 * pieces
        share = 8 / pieces
        item = fetch_add_once(counts, STRIDE * level + NEXT, 1, lane)
        while item < total * pieces:
            number = item / pieces
            some = ((1 << share) - 1) << (share * (item % pieces))
            if first == 0:
                some = some & octants[number]
                number = boxes[number]
            mesh, at = unravel(number, parents)
            some = octants_to_open(slab, values, mesh, at, bits, some)
            scale = float(caps.tree.frame[mesh * FRAME_SIZE + SCALE])
            whole_near = int(-1)
            middle = wp.vec3()
            reach = float(0.0)
            # First the box, then its octants: as many beside each other as what is near leaves room for.
            keep = not is_one(some)
            while some != 0:
                parts = int(1)
                if not keep and whole_near >= 0:
                    parts = parts_together(some, whole_near, lanes)
                parts = one_on_cpu(parts)
                part = one_on_cpu(lanes / parts)
                octant = bit_at(some, lane / part)
                idle = octant > 7
                child = 2 * at
                size = 2 << bits
                if not keep:
                    child = child + octant_at(octant)
                    size = 1 << bits
                start = wp.vec3i(child[0] << bits, child[1] << bits, child[2] << bits)
                box = box_of_voxels(slab_of(slab, mesh), start, size, scale)
                radius = wp.sqrt(box.half2)
                field = Field()
                handed = int(-1)
                if keep:
                    middle = box.centre
                    radius = radius * WIDER
                    reach = radius
                else:
                    way = box.centre - middle
                    if whole_near >= 0 and wp.length(way) + radius <= reach:
                        field = moved_field(field_at(stack, whole_at), way)
                        handed = whole_near
                field, near_at = descend(
                    caps,
                    mesh,
                    box.centre,
                    radius,
                    tolerance,
                    listed,
                    field,
                    handed,
                    keep,
                    stack,
                    lane,
                    lanes,
                    part,
                    idle,
                )
                if keep:
                    if field.error < wp.inf:
                        whole_near = field.near
                    if lane == 0:
                        put_field(stack, whole_at, field)
                    wait_for_lanes()
                    keep = bool(False)
                else:
                    far = largest_share(field, most_change(field, box.half)) < LARGEST_SHARE
                    hopeless = field.near > settled or doubt(field) > MOST_DOUBT
                    here = ((mesh * cells[0] + child[0]) * cells[1] + child[1]) * cells[2] + child[2]
                    done = put_record(
                        records, counts, STRIDE * level + RECORDED, STRIDE * level + RECORDED_NEAR,
                        not idle and not far and not hopeless, here, field, stack, near_at, lane, part,
                    )  # fmt: skip
                    if not idle and (lane & (part - 1)) == 0:
                        fetch_add(counts, STRIDE * level + LOOKED, 1)
                        if not far and not done:
                            place = fetch_add(counts, STRIDE * (level + 1) + LENGTH, 1)
                            left[place] = here
                            left_octants[place] = 255
                    for _part in range(unknown(parts)):
                        some = some & (some - 1)
                    # All have read the lists before others take their place.
                    wait_for_lanes()
            item = fetch_add_once(counts, STRIDE * level + NEXT, 1, lane)

    return see_boxes


# By parts of groups of lanes beside each other, and by all lanes at one box: where faces are the caps hundreds of nodes
# are near an octant, which is work for all.
SEE_BOXES = [_see_boxes_kernel(parts_beside, see_in_parts), _see_boxes_kernel(one_part, see_by_all)]
