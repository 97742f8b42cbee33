"""Descent of the tree of caps for a box of voxels, by a whole group of lanes: a field, and a list of single near caps.

As `cap_descent` has it for parts of groups, with what a GPU's first looks want: each lane looks at two nodes at a time,
so that two wait for memory at once, and all lanes are at one box, as hundreds of nodes are near even an octant of 4^3
voxels among many caps.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import tree_of
from sdm.kernels.primitives.fast_math import about_inverse_root, about_quotient
from sdm.kernels.primitives.lanes import GPU_LANES, ballot, members, rank, unknown, wait_for_lanes
from sdm.kernels.primitives.shared_stacks import FIELD_PLACES, LARGE_STACK
from sdm.kernels.primitives.vector_loads import load4
from sdm.kernels.winding.cap_descent import HOPELESS, NEAREST, SMALL, add_far, most_from, most_of, rest_of, sum_of_parts
from sdm.kernels.winding.cap_field import Field
from sdm.kernels.winding.cap_taylor import add_cap, bound_of_cap, may_be_expanded
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE, Caps
from sdm.kernels.winding.near_caps import UNIT, WIDER, corners_from, near_cap, place_of_cap

wp.set_module_options({"enable_backward": False})

_ROWS = MOMENTS_SIZE // 4
# Places of a stack: nodes to open, up to 32 for each of 22 levels; far nodes that wait, and single caps; nodes that are
# handed down; near caps; and the field of the box around all.
_FAR = 22 * GPU_LANES
_SINGLE = _FAR + 3 * GPU_LANES
_HANDED = _SINGLE + 3 * GPU_LANES
NEAR_AT = _HANDED + 512
FIELD_AT = LARGE_STACK - FIELD_PLACES
_ROOM_HANDED, _ROOM_NEAR = NEAR_AT - _HANDED, FIELD_AT - NEAR_AT


@wp.func
def listed_with(stack: wp.array(dtype=wp.int32), at: int, count: int, room: int, wanted: bool, number: int, lane: int):
    """Put the numbers of those lanes that want it behind so many others in a list, as far as there is room; how many
    there are then, or would be.
    """
    mask = ballot(wanted)
    place = count + rank(mask, lane)
    if wanted and place < room:
        stack[at + place] = number
    return count + members(mask)


@wp.func
def see_box(
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
):
    """The caps' field for all points within `radius` of a centre (scaled), by a whole group of lanes.

    Single caps that no multipole tells wait until there is one for each lane, and so do far nodes. Caps whose Taylor
    polynomial will do are added, and up to `room` of the others are listed from NEAR_AT on; if there are more, none is,
    and they count as errors.

    Args:
        caps: The caps.
        mesh: The mesh that they are of.
        centre: The box's middle.
        radius: From there to the furthest point.
        tolerance: The largest bound of a node's error that is taken.
        room: For near caps.
        begin: The field of what is not under nodes that were handed down.
        handed: How many those are; if negative, the descent begins at the root, and with no field.
        keep: Hand down near caps and small near nodes, of which the field then tells the number, instead of listing
            any: if there is no room for them the error is infinite.
        stack: Of this group (`large_stack_of`).
        lane: This lane's number.
        lanes: Their number.
    """
    one = tree_of(caps.tree, mesh)
    base = one.root
    leaves = 1 << one.depth
    field = Field()
    steps = float(0.0)
    near = int(0)
    queued = int(0)
    single = int(0)
    waiting = int(0)
    # Of what was handed down, what has not been looked at.
    rest = wp.max(handed, 0)
    near_at = wp.where(keep, _HANDED, NEAR_AT)
    places = wp.where(keep, _ROOM_HANDED, wp.min(room, _ROOM_NEAR))
    if handed < 0:
        # Each lane opens a node and looks at both of its children.
        waiting = wp.min(lanes, leaves / 2)
        if lane < waiting:
            stack[lane] = waiting + lane
        if leaves == 1:
            waiting = int(1)
            stack[0] = 0
    elif lane == 0:
        field = begin
    wait_for_lanes()
    while waiting + rest + queued + single > 0:
        over = waiting + rest == 0
        if queued >= lanes or (over and queued >= single):
            taken = wp.min(queued, lanes)
            queued = queued - taken
            if lane < taken:
                field = add_far(field, caps, base + stack[_FAR + queued + lane], centre, radius)
                steps = steps + 1.0
        elif single >= lanes or over:
            taken = wp.min(single, lanes)
            single = single - taken
            listed = bool(False)
            node = int(0)
            place = int(0)
            if lane < taken:
                node = stack[_SINGLE + single + lane]
                place = place_of_cap(caps, mesh, node - leaves)
                a, b, c = corners_from(caps, place, centre)
                angle, wrong = near_cap(a, b, c)
                bound = bound_of_cap(a, b, c, radius * WIDER, angle, wrong)
                if bound <= tolerance:
                    field = add_cap(field, a, b, c, radius * WIDER)
                    field.value = field.value + wp.float64(angle)
                    field.error = field.error + wrong + WIDER * bound
                    steps = steps + 1.0
                else:
                    if not keep:
                        field.left_out = field.left_out + most_of(caps, base + node, centre, radius)
                    listed = bool(True)
            near = listed_with(stack, near_at, near, places, listed, wp.where(keep, node, place), lane)
        else:
            # No node is 0.
            node = int(0)
            other = int(0)
            if waiting > 0:
                taken = wp.min(waiting, lanes)
                waiting = waiting - taken
                if lane < taken:
                    node = 2 * stack[waiting + lane]
                    other = node + 1
            else:
                taken = wp.min(rest, 2 * lanes)
                rest = rest - taken
                if lane < taken:
                    node = stack[_HANDED + rest + lane]
                if lane + lanes < taken:
                    other = stack[_HANDED + rest + lanes + lane]
            r0 = wp.vec4()
            r1 = wp.vec4()
            s0 = wp.vec4()
            s1 = wp.vec4()
            if node > 0:
                r0 = load4(caps.moments, _ROWS * (base + node))
                r1 = load4(caps.moments, _ROWS * (base + node) + 1)
            if other > 0:
                s0 = load4(caps.moments, _ROWS * (base + other))
                s1 = load4(caps.moments, _ROWS * (base + other) + 1)
            wait_for_lanes()
            for _child in range(unknown(2)):
                far = bool(False)
                opened = bool(False)
                alone = bool(False)
                listed = bool(False)
                # Where there is no node there is no area, or no roughness either.
                if r1[1] > 0.0:
                    u = wp.vec3(r0[0], r0[1], r0[2]) - centre
                    inverse = about_inverse_root(wp.dot(u, u))
                    distance = wp.dot(u, u) * inverse
                    reach = (radius + r0[3]) * WIDER
                    left = distance - reach
                    if reach < 0.9 * distance and distance > NEAREST:
                        bound = r1[0] * rest_of(radius, r0[3], r1[2], reach * inverse, inverse)
                        if bound <= tolerance * (left * left):
                            per = about_quotient(WIDER, left * left)
                            field.error = field.error + per * (bound + r1[1])
                            field.drift = field.drift + per * radius * inverse * r1[0]
                            far = bool(True)
                    if not far:
                        opened = node < leaves and not (keep and r0[3] <= SMALL * radius)
                        if node >= leaves and places > 0:
                            alone = may_be_expanded(r0[3], distance, radius, tolerance)
                        listed = not opened and not alone
                        if listed and not keep:
                            field.left_out = field.left_out + most_from(r1[0], left)
                number = node
                if listed and not keep:
                    number = place_of_cap(caps, mesh, wp.max(node - leaves, 0))
                queued = listed_with(stack, _FAR, queued, 3 * GPU_LANES, far, node, lane)
                single = listed_with(stack, _SINGLE, single, 3 * GPU_LANES, alone, node, lane)
                near = listed_with(stack, near_at, near, places, listed, number, lane)
                waiting = listed_with(stack, 0, waiting, _FAR, opened, node, lane)
                node = other
                r0 = s0
                r1 = s1
        if keep and near > places:
            field.error = float(wp.inf)
        hopeless = field.error + wp.where(near > places, field.left_out, 0.0) >= HOPELESS
        if ballot(hopeless) != wp.uint32(0):
            # Nothing will be known, as not all is added up.
            field.error = float(wp.inf)
            waiting = int(0)
            single = int(0)
            rest = int(0)
            queued = int(0)
        wait_for_lanes()
    field.error = field.error + 4.0 * UNIT * (steps + 6.0) * field.drift
    field = sum_of_parts(field, lanes, True)
    if near <= places:
        field.near = near
    else:
        field.error = field.error + field.left_out
    return field
