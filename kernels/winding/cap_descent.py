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
from sdm.kernels.primitives.fast_math import about_inverse_root, about_quotient, about_root
from sdm.kernels.primitives.lanes import (
    GPU_LANES,
    across,
    across_in_double,
    ballot,
    ballot_of_some,
    members,
    on_cpu,
    one_on_cpu,
    rank,
    wait_for_lanes,
)
from sdm.kernels.primitives.shared_stacks import FIELD_PLACES, LARGE_STACK, LARGE_STACK_ON_CPU
from sdm.kernels.primitives.vector_loads import load4
from sdm.kernels.winding.cap_field import Field, add_node
from sdm.kernels.winding.cap_taylor import add_cap, bound_of_cap, may_be_expanded
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE, Caps, load_fourth, load_rest
from sdm.kernels.winding.near_caps import (
    NEAR_EACH,
    NEAR_LIST,
    UNIT,
    WIDER,
    corners_from,
    near_cap,
    place_of_cap,
)

wp.set_module_options({"enable_backward": False})

_ROWS = MOMENTS_SIZE // 4
# An error of so much, a quarter of the winding number, leaves every side open.
HOPELESS = wp.PI
# Places of a stack, of which parts of a group of lanes have parts: nodes of a descent, at most one for each lane and
# each of 22 levels; single caps that wait; near caps (`near_list_of`); nodes that are handed down, to all parts; and
# far nodes that wait, which on a CPU is one at a time.
_NODES, _SINGLES = 22, 2
_SINGLE = GPU_LANES * _NODES
_HANDED_ON_GPU = NEAR_LIST + GPU_LANES * NEAR_EACH
_FAR_ON_GPU, _FAR_ON_CPU = LARGE_STACK - FIELD_PLACES - 2 * GPU_LANES, _SINGLE - 1
MOST_NEAR = {"cuda": _FAR_ON_GPU - _HANDED_ON_GPU, "cpu": (LARGE_STACK_ON_CPU - FIELD_PLACES - NEAR_LIST) // 2}
_ALL_ON_GPU = _FAR_ON_GPU - NEAR_LIST
_NEAR_ON_GPU, _NEAR_ON_CPU = MOST_NEAR["cuda"], MOST_NEAR["cpu"]
# A node that is near is handed down without being opened if it is no larger than so many radii of the box: opened, it
# would be near again.
SMALL = 1.0
# Nothing nearer is taken for far: its powers would leave the range of float32.
NEAREST = 1.0e-7


@wp.func
def most_from(area: float, left: float):
    """A bound of the solid angle of caps of so much area that are so far away."""
    most = float(2.0 * wp.PI)
    if left > NEAREST:
        most = wp.min(most, WIDER * about_quotient(area, left * left))
    return most


@wp.func
def most_of(caps: Caps, node: int, centre: wp.vec3, radius: float):
    """A bound of the solid angle of what is under a node, for all points within `radius` of the centre."""
    r0 = load4(caps.moments, _ROWS * node)
    way = wp.vec3(r0[0], r0[1], r0[2]) - centre
    left = about_root(wp.dot(way, way)) - (radius + r0[3]) * WIDER
    return most_from(load4(caps.moments, _ROWS * node + 1)[0], left)


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
def add_far(field: Field, caps: Caps, node: int, centre: wp.vec3, radius: float):
    """Add what is under a node, counted through all trees, to a field about a centre that it is far from."""
    r0 = load4(caps.moments, _ROWS * node)
    r1 = load4(caps.moments, _ROWS * node + 1)
    u = wp.vec3(r0[0], r0[1], r0[2]) - centre
    m = load_rest(caps.moments, node, r0, r1)
    return add_node(field, m, load_fourth(caps.moments, node), u, about_inverse_root(wp.dot(u, u)), radius)


@wp.func
def sum_of_parts(field: Field, some: int, sloped: bool):
    """The field that each so many neighbouring lanes have found together, the same for each of these."""
    step = int(1)
    while step < some:
        field.error = field.error + across(field.error, step)
        field.left_out = field.left_out + across(field.left_out, step)
        field.drift = field.drift + across(field.drift, step)
        field.value = field.value + across_in_double(field.value, step)
        if sloped:
            for axis in range(3):
                field.slope[axis] = field.slope[axis] + across(field.slope[axis], step)
                field.squares[axis] = field.squares[axis] + across(field.squares[axis], step)
                field.products[axis] = field.products[axis] + across(field.products[axis], step)
            for number in range(7):
                field.cubes[number] = field.cubes[number] + across(field.cubes[number], step)
        step = 2 * step
    return field


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
    some: int,
    idle: bool,
):
    """The caps' field for all points within `radius` of a centre (scaled), by a whole group of lanes or by each part.

    Single caps that no multipole tells wait on the stack until there is one for each lane, and so do far nodes, as
    adding one takes longer than looking at it. If the radius is zero, caps are added exactly. Else those whose Taylor
    polynomial will do are added, and up to `room` of the others are listed on the stack (`near_list_of`), at most
    MOST_NEAR, and at most a part's share; if there are more, none is, and they count as errors.

    Parts of a group descend beside each other, each for a ball of its own: what is near a box is little, and would
    leave most lanes of a group without work.

    Args:
        caps: The caps.
        mesh: The mesh that they are of.
        centre: The box's middle; as all down to `handed`, the same for all lanes of a part.
        radius: From there to the furthest point.
        tolerance: The largest bound of a node's error that is taken.
        room: For near caps.
        begin: The field of what is not under nodes that were handed down.
        handed: How many those are; if negative, the descent begins at the root, and with no field.
        keep: Hand down near caps and small near nodes, of which the field then tells the number, instead of listing
            any: MOST_NEAR at most, else the error is infinite. For whole groups alone.
        expand: Try Taylor polynomials. If not, nothing is known of what near caps add at most.
        few: So many caps, or fewer, under a node are near without a look at its bound.
        stack: Of this group (`large_stack_of`).
        lane: This lane's number.
        lanes: Their number.
        some: How many neighbouring lanes are a part, a power of two.
        idle: This part has nothing to look at.
    """
    one = tree_of(caps.tree, mesh)
    base = one.root
    leaves = 1 << one.depth
    some = one_on_cpu(some)
    mine = lane & (some - 1)
    first = wp.where(on_cpu(), 0, lane - mine)
    nodes_at = _NODES * first
    singles_at = _SINGLE + _SINGLES * first
    near_at = NEAR_LIST + NEAR_EACH * first
    far_at = wp.where(on_cpu(), _FAR_ON_CPU, _FAR_ON_GPU + 2 * first)
    field = Field()
    steps = float(0.0)
    near = int(0)
    single = int(0)
    waiting = int(0)
    queued = int(0)
    # Of what was handed down, what has not been looked at.
    rest = wp.max(handed, 0)
    # So many single caps may wait when nodes are looked at.
    full = wp.where(on_cpu(), 32, some)
    most = wp.where(on_cpu(), _NEAR_ON_CPU, _NEAR_ON_GPU)
    first_handed = wp.where(on_cpu(), NEAR_LIST + _NEAR_ON_CPU, _HANDED_ON_GPU)
    places = most
    if not keep:
        places = wp.where(handed < 0 and some == lanes, _ALL_ON_GPU, NEAR_EACH * some)
        places = wp.min(room, wp.where(on_cpu(), _NEAR_ON_CPU, places))
    if idle:
        rest = int(0)
    elif handed < 0:
        waiting = wp.min(some, leaves)
        if mine < waiting:
            stack[nodes_at + mine] = waiting + mine
    elif mine == 0:
        field = begin
    wait_for_lanes()
    while ballot(waiting + single + rest + queued > 0) != wp.uint32(0):
        node = int(0)
        opened = bool(False)
        alone = bool(False)
        listed = bool(False)
        far = bool(False)
        looks = int(0)
        if single <= full and queued <= some:
            looks = wp.min(some, waiting + rest)
        # All parts look at nodes, or all add far ones or single caps, once these are enough for most lanes.
        ready = members(ballot(mine < single))
        ready_far = members(ballot(mine < queued))
        can_look = ballot(looks > 0) != wp.uint32(0)
        if 4 * ready_far >= 3 * lanes or (ready_far > 0 and not can_look and ready <= ready_far):
            taken = wp.min(some, queued)
            queued = queued - taken
            if mine < taken:
                field = add_far(field, caps, base + stack[far_at + queued + mine], centre, radius)
                steps = steps + 1.0
        elif can_look and (on_cpu() or 4 * ready < 3 * lanes):
            taken = wp.min(looks, waiting)
            more = looks - taken
            waiting = waiting - taken
            rest = rest - more
            if mine < taken:
                node = stack[nodes_at + waiting + mine]
            elif mine < looks:
                node = stack[first_handed + rest + mine - taken]
            wait_for_lanes()
            if node > 0:
                at = _ROWS * (base + node)
                r0 = load4(caps.moments, at)
                r1 = load4(caps.moments, at + 1)
                if r1[1] > 0.0:
                    u = wp.vec3(r0[0], r0[1], r0[2]) - centre
                    inverse = about_inverse_root(wp.dot(u, u))
                    distance = wp.dot(u, u) * inverse
                    reach = (radius + r0[3]) * WIDER
                    bound = float(wp.inf)
                    inverse2 = float(0.0)
                    left = distance - reach
                    if few * node < leaves and reach < 0.9 * distance and distance > NEAREST:
                        part = r1[0] * rest_of(radius, r0[3], r1[2], reach * inverse, inverse)
                        if part <= tolerance * (left * left):
                            inverse2 = about_quotient(1.0, left * left)
                            bound = part * inverse2
                    if bound < wp.inf:
                        field.error = field.error + WIDER * (bound + r1[1] * inverse2)
                        field.drift = field.drift + WIDER * radius * inverse * r1[0] * inverse2
                        far = bool(True)
                    elif keep and node < leaves and r0[3] <= SMALL * radius:
                        listed = bool(True)
                    elif node < leaves:
                        opened = bool(True)
                    elif radius > 0.0 and (
                        places == 0 or not expand or not may_be_expanded(r0[3], distance, radius, tolerance)
                    ):
                        # Counted for all lanes at once: they have to agree on how many are near.
                        most_left = float(wp.inf)
                        if expand:
                            most_left = most_of(caps, base + node, centre, radius)
                        field.left_out = field.left_out + most_left
                        listed = bool(True)
                    else:
                        alone = bool(True)
            mask = ballot_of_some(opened, lane, some)
            if opened:
                place = nodes_at + waiting + 2 * rank(mask, mine)
                stack[place] = 2 * node
                stack[place + 1] = 2 * node + 1
            waiting = waiting + 2 * members(mask)
            mask = ballot_of_some(far, lane, some)
            if far:
                stack[far_at + queued + rank(mask, mine)] = node
            queued = queued + members(mask)
            mask = ballot_of_some(alone, lane, some)
            if alone:
                stack[singles_at + single + rank(mask, mine)] = node
            single = single + members(mask)
        else:
            taken = wp.min(some, single)
            single = single - taken
            if mine < taken:
                node = stack[singles_at + single + mine]
                cap = place_of_cap(caps, mesh, node - leaves)
                a, b, c = corners_from(caps, cap, centre)
                angle, wrong = near_cap(a, b, c)
                bound = float(0.0)
                if radius > 0.0:
                    bound = bound_of_cap(a, b, c, radius * WIDER, angle, wrong)
                if bound <= tolerance:
                    if radius > 0.0:
                        field = add_cap(field, a, b, c, radius * WIDER)
                    field.value = field.value + wp.float64(angle)
                    field.error = field.error + wrong + WIDER * bound
                    steps = steps + 1.0
                else:
                    if not keep:
                        field.left_out = field.left_out + most_of(caps, base + node, centre, radius)
                    listed = bool(True)
        mask = ballot_of_some(listed, lane, some)
        if listed and near + members(mask) <= places:
            place = near + rank(mask, mine)
            if keep:
                stack[first_handed + place] = node
            else:
                stack[near_at + place] = place_of_cap(caps, mesh, node - leaves)
        near = near + members(mask)
        if keep and near > places:
            field.error = float(wp.inf)
        hopeless = field.error + wp.where(near > places, field.left_out, 0.0) >= HOPELESS
        if ballot_of_some(hopeless, lane, some) != wp.uint32(0):
            # Nothing will be known, as not all is added up.
            field.error = float(wp.inf)
            waiting = int(0)
            single = int(0)
            rest = int(0)
            queued = int(0)
        wait_for_lanes()
    field.error = field.error + 4.0 * UNIT * (steps + 6.0) * field.drift
    field = sum_of_parts(field, some, ballot(radius > 0.0) != wp.uint32(0))
    if near <= places:
        field.near = near
    else:
        field.error = field.error + field.left_out
    return field
