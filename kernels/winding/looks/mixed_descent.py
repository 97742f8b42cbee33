"""Descent of the tree of caps for a box of voxels in doubt: nodes for its field, nodes for its voxels, single caps.

A node whose bound of the error over all the box is at most a tolerance goes into the box's field (`cap_field`). One
that is too near for that, but not for any single voxel of the box, is listed, to be added to each (`node_sum`). Others
are opened, and caps that are too near even so are listed, to be added exactly (`near_caps`). So a small tolerance lists
some hundred nodes, where it would list a thousand caps.

What a box would list it may hand down instead: a part of it begins with that instead of the root, and most of it is far
for a smaller box.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import tree_of
from sdm.kernels.primitives.fast_math import about_inverse_root, about_quotient
from sdm.kernels.primitives.lanes import GPU_LANES, ballot, members, rank, unknown, wait_for_lanes
from sdm.kernels.primitives.shared_stacks import LARGE_STACK
from sdm.kernels.primitives.vector_loads import load4
from sdm.kernels.winding.cap_descent import NEAREST, SMALL, add_far, rest_of, sum_of_parts
from sdm.kernels.winding.cap_field import Field
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE, Caps
from sdm.kernels.winding.looks.node_sum import SUMMED
from sdm.kernels.winding.near_caps import UNIT, WIDER, place_of_cap

wp.set_module_options({"enable_backward": False})

_ROWS = MOMENTS_SIZE // 4
# Places of a stack: nodes to open, up to 32 for each of 22 levels; far nodes that wait until all lanes have one to add;
# a box's voxels; the nodes for voxels from their place on, or to be handed down, and the caps up to the end.
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
    handed: wp.array(dtype=wp.int32),
    handed_at: int,
    handed_down: int,
    rooted: bool,
    keep: bool,
    stack: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
):
    """The caps seen from all points within `radius` of a centre (scaled), by a whole group of lanes.

    Nodes are listed from NODES on, and caps up to END. The error is infinite if more than `room` of them would be.

    Args:
        caps: The caps.
        mesh: The mesh that they are of.
        centre: The box's middle.
        radius: From there to the furthest voxel.
        tolerance: The largest bound of a node's error that is taken.
        room: For nodes and caps in the list, at most ROOM.
        handed: Nodes that were handed down, of which the field is.
        handed_at: The place of the first of them.
        handed_down: How many those are; if negative, the descent begins at the root.
        rooted: It does so whatever was handed down.
        keep: Hand down what would be listed, as nodes that the field is without: nothing is listed for voxels.
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
    waiting = int(0)
    # Of what was handed down, what has not been looked at.
    rest = wp.where(rooted, 0, wp.max(handed_down, 0))
    if rooted or handed_down < 0:
        # Each lane opens a node and looks at both of its children, so that two wait for memory at once.
        waiting = wp.min(lanes, leaves / 2)
        if lane < waiting:
            stack[lane] = waiting + lane
        if leaves == 1:
            waiting = int(1)
            stack[0] = 0
    wait_for_lanes()
    while waiting + rest + queued > 0:
        if queued >= lanes or waiting + rest == 0:
            taken = wp.min(queued, lanes)
            queued = queued - taken
            if lane < taken:
                field = add_far(field, caps, base + stack[WAITING + queued + lane], centre, radius)
                steps = steps + 1.0
            wait_for_lanes()
        else:
            # No node is 0.
            node = int(0)
            other = int(0)
            if rooted or waiting > 0:
                taken = wp.min(waiting, lanes)
                waiting = waiting - taken
                if lane < taken:
                    node = 2 * stack[waiting + lane]
                    other = node + 1
            else:
                taken = wp.min(rest, 2 * lanes)
                rest = rest - taken
                if lane < taken:
                    node = handed[handed_at + rest + lane]
                if lane + lanes < taken:
                    other = handed[handed_at + rest + lanes + lane]
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
                listed = bool(False)
                opened = bool(False)
                single = bool(False)
                # Where there is no node there is no area, or no roughness either.
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
                        if far or (listed and not keep):
                            per = about_quotient(WIDER, left2)
                            field.error = field.error + per * (bound + r1[1])
                            if far:
                                field.drift = field.drift + per * radius * inverse * r1[0]
                            else:
                                filled = filled + per * r1[0]
                    if not far and not listed:
                        opened = node < leaves and not (keep and r0[3] <= SMALL * radius)
                        single = not opened and not keep
                        listed = not opened and keep
                mask = ballot(far)
                if far:
                    stack[WAITING + queued + rank(mask, lane)] = node
                queued = queued + members(mask)
                mask = ballot(listed)
                place = nodes + rank(mask, lane)
                if listed and place + singles < room:
                    stack[NODES + place] = node
                nodes = nodes + members(mask)
                mask = ballot(single)
                place = singles + rank(mask, lane)
                if single and nodes + place < room:
                    stack[END - 1 - place] = place_of_cap(caps, mesh, node - leaves)
                singles = singles + members(mask)
                mask = ballot(opened)
                if opened:
                    stack[waiting + rank(mask, lane)] = node
                waiting = waiting + members(mask)
                node = other
                r0 = s0
                r1 = s1
            if nodes + singles > room:
                field.error = float(wp.inf)
                waiting = int(0)
                rest = int(0)
                queued = int(0)
                nodes = int(0)
                singles = int(0)
            wait_for_lanes()
    field.error = field.error + 4.0 * UNIT * (steps + 6.0) * field.drift + SUMMED * filled
    found.field = sum_of_parts(field, lanes, True)
    found.nodes = nodes
    found.caps = singles
    return found
