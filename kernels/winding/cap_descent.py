"""Descent of the tree of caps for a box of voxels: what is far goes into a field, what is near into a list.

A node whose own bound (`cap_field`) is at most a tolerance is taken as it is, others are opened. A single cap that is
too near even so is added exactly if the box is a point, else it is left out, for others to add: seen from a distance d
its solid angle is at most area/d^2, and never more than half of all.

A box hands down what it has found: the descent for one of its octants begins with the field of the whole box, moved,
and with the nodes that were near for that, instead of the root.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import tree_of
from sdm.kernels.primitives.lanes import (
    ballot,
    members,
    on_cpu,
    rank,
    sum_of_lanes,
    sum_of_lanes_in_double,
    wait_for_lanes,
)
from sdm.kernels.primitives.shared_stacks import LARGE_STACK, LARGE_STACK_ON_CPU
from sdm.kernels.primitives.vector_loads import load4
from sdm.kernels.winding.cap_field import Field, add_node
from sdm.kernels.winding.cap_taylor import Taylor, taylor_of_cap
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE, Caps, load_fourth, load_rest
from sdm.kernels.winding.near_caps import NEAR_LIST, UNIT, WIDER, corners_from, near_cap, place_of_cap

wp.set_module_options({"enable_backward": False})

_ROWS = MOMENTS_SIZE // 4
# An error of so much, a quarter of the winding number, leaves every side open.
HOPELESS = wp.PI
# Places of a stack: nodes of a descent, at most 32 for each of 22 levels; single caps that wait; near caps; and as much
# room for nodes that are handed down.
MOST_SINGLE = 64
_SINGLE = NEAR_LIST - MOST_SINGLE
MOST_NEAR = {"cuda": (LARGE_STACK - NEAR_LIST) // 2, "cpu": (LARGE_STACK_ON_CPU - NEAR_LIST) // 2}
_NEAR_ON_GPU, _NEAR_ON_CPU = MOST_NEAR["cuda"], MOST_NEAR["cpu"]
# A node that is near is handed down without being opened if it is no larger than so many radii of the box: opened, it
# would be near again.
SMALL = 1.0
# Nothing nearer is taken for far: its powers would leave the range of float32.
NEAREST = 1.0e-7


@wp.func
def most_of(caps: Caps, node: int, centre: wp.vec3, radius: float):
    """A bound of the solid angle of what is under a node, for all points within `radius` of the centre."""
    r0 = load4(caps.moments, _ROWS * node)
    left = wp.length(wp.vec3(r0[0], r0[1], r0[2]) - centre) - (radius + r0[3]) * WIDER
    most = float(2.0 * wp.PI)
    if left > NEAREST:
        most = wp.min(most, WIDER * load4(caps.moments, _ROWS * node + 1)[0] / (left * left))
    return most


@wp.func
def rest_of(radius: float, r: float, sigma: float, rho: float, inverse: float):
    """The bound of a node's error, times (1 - rho)^2 D^2 / area (`cap_field`)."""
    # In units of the distance, as powers of lengths may leave the range of float32.
    far = inverse * radius
    wide = inverse * r
    mean = inverse * sigma
    square = mean * mean
    far2 = far * far
    fourth = far2 * (far2 + 4.0 * far * mean + 6.0 * square) + square * wide * (4.0 * far + wide)
    return (5.0 - 4.0 * rho) * fourth


@wp.func
def see_caps(
    caps: Caps,
    mesh: int,
    centre: wp.vec3,
    radius: float,
    tolerance: float,
    room: int,
    begin: Field,
    handed: int,
    keep: bool,
    expand: bool,
    few: int,
    stack: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
):
    """The caps' field for all points within `radius` of a centre (scaled), by a whole group of lanes.

    Single caps that no multipole tells wait on the stack until there is one for each lane. If the radius is zero, they
    are added exactly. Else those whose Taylor polynomial will do are added, and up to `room` of the others, at most
    MOST_NEAR, are listed on the stack; if there are more, none is, and they count as errors.

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
            any: MOST_NEAR at most, else the error is infinite.
        expand: Try Taylor polynomials. If not, nothing is known of what near caps add at most.
        few: So many caps, or fewer, under a node are near without a look at its bound.
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
    single = int(0)
    waiting = int(0)
    # Of what was handed down, what has not been looked at.
    rest = wp.max(handed, 0)
    most = wp.where(on_cpu(), _NEAR_ON_CPU, _NEAR_ON_GPU)
    first_handed = NEAR_LIST + most
    places = wp.where(keep, most, room)
    if handed < 0:
        waiting = wp.min(lanes, leaves)
        if lane < waiting:
            stack[lane] = waiting + lane
    elif lane == 0:
        field = begin
    wait_for_lanes()
    while waiting + single + rest > 0:
        node = int(0)
        opened = bool(False)
        alone = bool(False)
        listed = bool(False)
        if waiting + rest > 0 and single <= MOST_SINGLE - 32:
            taken = wp.min(lanes, waiting)
            waiting = waiting - taken
            if lane < taken:
                node = stack[waiting + lane]
            if taken < lanes:
                more = wp.min(lanes - taken, rest)
                rest = rest - more
                if lane >= taken and lane < taken + more:
                    node = stack[first_handed + rest + lane - taken]
            wait_for_lanes()
            if node > 0:
                at = _ROWS * (base + node)
                r0 = load4(caps.moments, at)
                r1 = load4(caps.moments, at + 1)
                if r1[1] > 0.0:
                    u = wp.vec3(r0[0], r0[1], r0[2]) - centre
                    distance = wp.length(u)
                    reach = (radius + r0[3]) * WIDER
                    bound = float(wp.inf)
                    left = distance - reach
                    if few * node < leaves and reach < 0.9 * distance and distance > NEAREST:
                        inverse = 1.0 / distance
                        part = r1[0] * rest_of(radius, r0[3], r1[2], reach * inverse, inverse)
                        if part <= tolerance * (left * left):
                            bound = part / (left * left)
                    if bound <= tolerance:
                        m = load_rest(caps.moments, base + node, r0, r1)
                        m4 = load_fourth(caps.moments, base + node)
                        field = add_node(field, m, m4, u, 1.0 / distance, radius)
                        field.error = field.error + WIDER * bound + r1[1] / (left * left)
                        field.drift = field.drift + radius / distance * r1[0] / (left * left)
                        steps = steps + 1.0
                    elif keep and node < leaves and r0[3] <= SMALL * radius:
                        listed = bool(True)
                    elif node < leaves:
                        opened = bool(True)
                    elif radius > 0.0 and (places == 0 or not expand):
                        # Counted for all lanes at once: they have to agree on how many are near.
                        most_left = float(wp.inf)
                        if expand:
                            most_left = most_of(caps, base + node, centre, radius)
                        field.left_out = field.left_out + most_left
                        listed = bool(True)
                    else:
                        alone = bool(True)
            mask = ballot(opened)
            if opened:
                place = waiting + 2 * rank(mask, lane)
                stack[place] = 2 * node
                stack[place + 1] = 2 * node + 1
            waiting = waiting + 2 * members(mask)
            mask = ballot(alone)
            if alone:
                stack[_SINGLE + single + rank(mask, lane)] = node
            single = single + members(mask)
        else:
            taken = wp.min(lanes, single)
            single = single - taken
            if lane < taken:
                node = stack[_SINGLE + single + lane]
                cap = place_of_cap(caps, mesh, node - leaves)
                a, b, c = corners_from(caps, cap, centre)
                angle, wrong = near_cap(a, b, c)
                t = Taylor()
                if radius > 0.0:
                    t = taylor_of_cap(a, b, c, radius * WIDER, angle, wrong)
                if t.bound <= tolerance:
                    field.value = field.value + wp.float64(angle)
                    field.slope = field.slope + t.slope
                    field.squares = field.squares + t.squares
                    field.products = field.products + t.products
                    field.cubes = field.cubes + t.cubes
                    field.error = field.error + wrong + WIDER * t.bound + t.rounding
                    field.drift = field.drift + t.drift
                    steps = steps + 1.0
                else:
                    if not keep:
                        field.left_out = field.left_out + most_of(caps, base + node, centre, radius)
                    listed = bool(True)
        mask = ballot(listed)
        if listed and near + members(mask) <= places:
            place = near + rank(mask, lane)
            if keep:
                stack[first_handed + place] = node
            else:
                stack[NEAR_LIST + place] = place_of_cap(caps, mesh, node - leaves)
        near = near + members(mask)
        if keep and near > places:
            field.error = float(wp.inf)
        if ballot(field.error + wp.where(near > places, field.left_out, 0.0) >= HOPELESS) != wp.uint32(0):
            # Nothing will be known, as not all is added up.
            field.error = float(wp.inf)
            waiting = int(0)
            single = int(0)
            rest = int(0)
        wait_for_lanes()
    field.error = sum_of_lanes(field.error + 4.0 * UNIT * (steps + 6.0) * field.drift)
    field.left_out = sum_of_lanes(field.left_out)
    if near <= places:
        field.near = near
    else:
        field.error = field.error + field.left_out
    field.value = sum_of_lanes_in_double(field.value)
    if radius > 0.0:
        for axis in range(3):
            field.slope[axis] = sum_of_lanes(field.slope[axis])
            field.squares[axis] = sum_of_lanes(field.squares[axis])
            field.products[axis] = sum_of_lanes(field.products[axis])
        for number in range(7):
            field.cubes[number] = sum_of_lanes(field.cubes[number])
    return field
