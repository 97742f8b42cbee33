"""Descent of the tree of caps for a box of voxels in doubt: nodes for its field, nodes for its voxels, single caps.

A node whose bound of the error over all the box is at most a tolerance goes into the box's field (`cap_field`). One
that is too near for that, but not for any single voxel of the box, is listed, to be added to each (`node_sum`). Others
are opened, and caps that are too near even so are listed, to be added exactly (`near_caps`). So a small tolerance lists
some hundred nodes, where it would list a thousand caps.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import tree_of
from sdm.kernels.primitives.fast_math import about_inverse_root, about_quotient
from sdm.kernels.primitives.lanes import GPU_LANES, ballot, members, rank, unknown, wait_for_lanes
from sdm.kernels.primitives.shared_stacks import LARGE_STACK
from sdm.kernels.primitives.vector_loads import load4
from sdm.kernels.winding.cap_descent import NEAREST, add_far, rest_of, sum_of_parts
from sdm.kernels.winding.cap_field import Field
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE, Caps
from sdm.kernels.winding.looks.node_sum import SUMMED
from sdm.kernels.winding.near_caps import UNIT, WIDER, place_of_cap

wp.set_module_options({"enable_backward": False})

_ROWS = MOMENTS_SIZE // 4
# Places of a stack: nodes to open, up to 32 for each of 22 levels; far nodes that wait until all lanes have one to add;
# a box's voxels; the nodes for voxels from their place on, and the caps up to the end.
WAITING = 22 * GPU_LANES
VOXELS = WAITING + 3 * GPU_LANES
NODES = VOXELS + 64
END = LARGE_STACK
ROOM = END - NODES
# The least distance from a node, in parts of that of its centre.
LEAST = 0.1


@wp.struct
class Looked:
    """Outcome of a descent: a field, and how many nodes and caps are listed for voxels."""

    field: Field
    nodes: wp.int32
    caps: wp.int32


@wp.func
def look_closer(
    caps: Caps,
    mesh: int,
    centre: wp.vec3,
    radius: float,
    tolerance: float,
    room: int,
    stack: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
):
    """The caps seen from all points within `radius` of a centre (scaled), by a whole group of lanes.

    The error is infinite if more than `room` nodes and caps would be listed, at most ROOM.

    Args:
        caps: The caps.
        mesh: The mesh that they are of.
        centre: The box's middle.
        radius: From there to the furthest voxel.
        tolerance: The largest bound of a node's error that is taken.
        room: For nodes and caps in the list.
        stack: Of this group (`large_stack_of`).
        lane: This lane's number.
        lanes: Their number.
    """
    one = tree_of(caps.tree, mesh)
    base = one.root
    leaves = 1 << one.depth
    found = Looked()
    field = Field()
    steps = float(0.0)
    # A bound of what the listed nodes fill.
    filled = float(0.0)
    nodes = int(0)
    singles = int(0)
    queued = int(0)
    wide = radius * WIDER
    # Each lane opens a node and looks at both of its children, so that two wait for memory at once.
    waiting = wp.min(lanes, leaves / 2)
    if lane < waiting:
        stack[lane] = waiting + lane
    if leaves == 1:
        waiting = int(1)
        stack[0] = 0
    wait_for_lanes()
    while waiting + queued > 0:
        if queued >= lanes or waiting == 0:
            taken = wp.min(queued, lanes)
            queued = queued - taken
            if lane < taken:
                field = add_far(field, caps, base + stack[WAITING + queued + lane], centre, radius)
                steps = steps + 1.0
            wait_for_lanes()
        else:
            taken = wp.min(waiting, lanes)
            waiting = waiting - taken
            child = int(0)
            r0 = wp.vec4()
            r1 = wp.vec4()
            s0 = wp.vec4()
            s1 = wp.vec4()
            if lane < taken:
                child = 2 * stack[waiting + lane]
                r0 = load4(caps.moments, _ROWS * (base + child))
                r1 = load4(caps.moments, _ROWS * (base + child) + 1)
                s0 = load4(caps.moments, _ROWS * (base + child) + _ROWS)
                s1 = load4(caps.moments, _ROWS * (base + child) + _ROWS + 1)
                if child == 0:
                    # Nothing is above the root.
                    r1[1] = float(0.0)
            wait_for_lanes()
            for _child in range(unknown(2)):
                far = bool(False)
                listed = bool(False)
                opened = bool(False)
                single = bool(False)
                # A place behind the taken ones has no area, or no roughness either.
                if r1[1] > 0.0:
                    u = wp.vec3(r0[0], r0[1], r0[2]) - centre
                    inverse = about_inverse_root(wp.dot(u, u))
                    distance = wp.dot(u, u) * inverse
                    r = r0[3] * WIDER
                    left = distance - wide - r
                    if left > LEAST * distance and distance > NEAREST:
                        left2 = left * left
                        bound = r1[0] * rest_of(radius, r0[3], r1[2], (wide + r) * inverse, inverse)
                        if bound <= tolerance * left2:
                            far = bool(True)
                        else:
                            # At a voxel, which may be nearer by the radius.
                            near = about_quotient(WIDER, distance - wide)
                            off = near * r
                            spread = off * near * r1[2]
                            bound = r1[0] * (5.0 - 4.0 * off) * spread * spread
                            listed = bound <= tolerance * left2
                        if far or listed:
                            per = about_quotient(WIDER, left2)
                            field.error = field.error + per * (bound + r1[1])
                            if far:
                                field.drift = field.drift + per * radius * inverse * r1[0]
                            else:
                                filled = filled + per * r1[0]
                    if not far and not listed:
                        opened = child < leaves
                        single = not opened
                mask = ballot(far)
                if far:
                    stack[WAITING + queued + rank(mask, lane)] = child
                queued = queued + members(mask)
                mask = ballot(listed)
                place = nodes + rank(mask, lane)
                if listed and place + singles < room:
                    stack[NODES + place] = child
                nodes = nodes + members(mask)
                mask = ballot(single)
                place = singles + rank(mask, lane)
                if single and nodes + place < room:
                    stack[END - 1 - place] = place_of_cap(caps, mesh, child - leaves)
                singles = singles + members(mask)
                mask = ballot(opened)
                if opened:
                    stack[waiting + rank(mask, lane)] = child
                waiting = waiting + members(mask)
                child = child + 1
                r0 = s0
                r1 = s1
            if nodes + singles > room:
                field.error = float(wp.inf)
                waiting = int(0)
                queued = int(0)
                nodes = int(0)
                singles = int(0)
            wait_for_lanes()
    field.error = field.error + 4.0 * UNIT * (steps + 6.0) * field.drift + SUMMED * filled
    found.field = sum_of_parts(field, lanes, True)
    found.nodes = nodes
    found.caps = singles
    return found
