"""The solid angle of an open mesh's caps over a box of voxels, as a polynomial with a bound of its error.

The solid angle of far caps is a harmonic function in the box. With the sources at y about a node's centre, the voxels
at x about the box's, and u between the centres, it is the integral of n.z/|z|^3 for z = u + y - x, which is expanded
in x and y together up to the second order:

    value + slope.x + x.bend x,   value from M1, M2 and M3, slope from M1 and M2, bend from M1 (`cap_tree`).

Why the rest is bounded: a derivative of order m of 1/|z| along any m unit vectors is at most m!/|z|^(m+1), as a
symmetric form is largest where all its arguments are equal, and there it is m! times a Legendre polynomial. The term
of order i in x and j in y, with its derivative along n, is thus at most (i+j+1)!/(i! j!) R^i r^j / D^(i+j+2) times
the area, R and r being the radii of box and node and D = |u|; with rho = (R + r)/D all terms of the orders i+j = m add
up to (m + 1) rho^m / D^2, and those from the third order on to

    area / D^2 * rho^3 (4 - 3 rho) / (1 - rho)^2.

Where |y| is not as large as r, that is better: with the mean over the area of (R + |y|)^3 in the place of (R + r)^3,
of which sigma^2, the mean of |y|^2, is enough to know: at most R^3 + 3 R^2 sigma + 3 R sigma^2 + r sigma^2.

The tree is descended from the root. A node whose own bound is at most a tolerance is taken as it is, others are opened.
A single cap that is too near even so is added exactly if the box is a point, else it is left out, for others to add:
seen from a distance d its solid angle is at most area/d^2, and never more than half of all.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import first_triangle, nodes_of
from sdm.kernels.primitives.fast_math import about_quotient, about_root
from sdm.kernels.primitives.lanes import (
    ballot,
    members,
    rank,
    sum_of_lanes,
    sum_of_lanes_in_double,
    wait_for_lanes,
)
from sdm.kernels.primitives.shared_stacks import STACK
from sdm.kernels.primitives.vector_loads import load4
from sdm.kernels.winding.cap_taylor import Taylor, taylor_of_cap
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE, Caps, Moments, load_rest

wp.set_module_options({"enable_backward": False})

_ROWS = MOMENTS_SIZE // 4
# An error of so much, a quarter of the winding number, leaves every side open.
HOPELESS = wp.PI
FULL = 4.0 * wp.PI
# Near caps that a stack has room for, and single caps that wait, besides the nodes of a descent: at most 32 for each
# level below the fifth, of 22 levels at most.
MOST_NEAR, MOST_SINGLE = 320, 64
_SINGLE = STACK - MOST_NEAR - MOST_SINGLE
# Nothing nearer is taken for far: its powers would leave the range of float32.
NEAREST = 1.0e-8
# Room for the rounding of rho, and of a bound.
WIDER = 1.0001
UNIT = 2.0**-24
# The errors of a near cap's half solid angle, see `near_cap`.
ROUNDINGS = 100.0 * UNIT
LARGEST_PRODUCT = 1.0e9
SNAP = 2.0 * UNIT


@wp.struct
class Field:
    """The caps' solid angle near a point: at x from it, value + slope.x + x.bend x, give or take the error."""

    value: wp.float64
    slope: wp.vec3
    squares: wp.vec3  # of bend the entries xx, yy and zz
    products: wp.vec3  # and the sums of its entries xy and yx, xz and zx, yz and zy
    error: float  # infinite if nothing is known
    left_out: float  # what near caps that are not in it may add at most
    near: wp.int32  # how many of them are listed; without a list they are part of the error
    drift: float  # what the rounding of slope and bend is in proportion to


@wp.func
def add_node(field: Field, m: Moments, u: wp.vec3, inverse: float):
    """Add a far node: `u` leads from the field's centre to the node's, a unit vector times 1 / inverse."""
    z = u * inverse
    d = wp.dot(m.m1, z)
    v = m.m2 * z
    q = wp.dot(z, v) * inverse
    xx = z[0] * z[0]
    yy = z[1] * z[1]
    zz = z[2] * z[2]
    s = m.m3
    cubic = z[0] * (xx * s[0] + 3.0 * (yy * s[3] + zz * s[5])) + z[1] * (yy * s[6] + 3.0 * (xx * s[1] + zz * s[8]))
    cubic = cubic + z[2] * (zz * s[9] + 3.0 * (xx * s[2] + yy * s[7])) + 6.0 * z[0] * z[1] * z[2] * s[4]
    i2 = inverse * inverse
    i3 = i2 * inverse
    i4 = i2 * i2
    field.value = field.value + wp.float64(i2 * (d - 3.0 * q + 7.5 * i2 * cubic))
    field.slope = field.slope + i3 * (z * (3.0 * d - 15.0 * q) - m.m1 + 6.0 * inverse * v)
    w = 7.5 * d * z - 3.0 * m.m1
    diagonal = wp.vec3(w[0] * z[0], w[1] * z[1], w[2] * z[2]) - wp.vec3(1.5 * d, 1.5 * d, 1.5 * d)
    field.squares = field.squares + i4 * diagonal
    # 15 d z z' - 3 (m1 z' + z m1').
    other = wp.vec3(
        w[0] * z[1] + w[1] * z[0],
        w[0] * z[2] + w[2] * z[0],
        w[1] * z[2] + w[2] * z[1],
    )
    field.products = field.products + i4 * other
    return field


@wp.func
def cap_factor(a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """f, v and s of `near_cap`, and the least of the lengths."""
    la = about_root(wp.dot(a, a))
    lb = about_root(wp.dot(b, b))
    lc = about_root(wp.dot(c, c))
    size = la * lb * lc
    v = wp.dot(a, wp.cross(b, c))
    f = size + wp.dot(a, b) * lc + wp.dot(b, c) * la + wp.dot(c, a) * lb
    return f, v, size, wp.min(la, wp.min(lb, lc))


@wp.func
def is_known(f: float, v: float, most: float, room: float, least: float):
    """True if an angle is known to within its bound.

    A product of lengths that underflows is in doubt; so is what overflows, or is not a number.
    """
    return most * least > 10.0 * room and (f > 0.0 or wp.abs(v) * least > room)


@wp.func
def near_cap(a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """The solid angle of a triangle with corners at a, b and c from the point, and the largest error of it.

    Half of it is the argument of f + iv, where v = a.(b x c) and f = |a||b||c| + a.b|c| + b.c|a| + c.a|b| (van
    Oosterom and Strackee 1983). In units of s = |a||b||c| and u = 2^-24: a, b and c are differences of float32 numbers,
    each rounded once, and lengths have errors of at most 4u; v then has an error of at most 14u, f of at most 65u. The
    places on the lattice, which are those that count, are up to 0.1u away: that moves f + iv by 1.3u over the least of
    the lengths. So the argument is right within (100u + 2u/least) s/|f + iv|, if that is small and the negative real
    axis, where it jumps by a turn, is further away; else nothing is known.
    """
    f, v, size, least = cap_factor(a, b, c)
    most = wp.max(wp.abs(v), wp.abs(f))
    room = (ROUNDINGS * least + SNAP) * size
    error = float(wp.inf)
    angle = float(0.0)
    if is_known(f, v, most, room, least):
        error = 2.0 * room / (most * least)
        angle = 2.0 * wp.atan2(v, f)
    return angle, error


@wp.func
def corners_from(caps: Caps, mesh: int, leaf: int, p: wp.vec3):
    """The ways from p (scaled) to the corners of the cap in a leaf of a mesh's tree."""
    slot = 4 * (mesh * caps.tree.count + first_triangle(caps.tree, leaf))
    return caps.tree.corners[slot] - p, caps.tree.corners[slot + 1] - p, caps.tree.corners[slot + 2] - p


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
def see_caps(
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
    """The caps' field for all points within `radius` of a centre (scaled), by a whole group of lanes.

    Single caps that no multipole tells wait on the stack until there is one for each lane. If the radius is zero, they
    are added exactly. Else those whose Taylor polynomial will do are added, and up to `room` of the others, at most
    MOST_NEAR, are listed from the stack's end; if there are more, none is, and they count as errors.
    """
    base = nodes_of(caps.tree, mesh)
    leaves = 1 << caps.tree.depth
    field = Field()
    steps = float(0.0)
    near = int(0)
    single = int(0)
    waiting = wp.min(lanes, leaves)
    if lane < waiting:
        stack[lane] = waiting + lane
    wait_for_lanes()
    while waiting + single > 0:
        node = int(0)
        opened = bool(False)
        alone = bool(False)
        listed = bool(False)
        if waiting > 0 and single <= MOST_SINGLE - 32:
            taken = wp.min(lanes, waiting)
            waiting = waiting - taken
            if lane < taken:
                node = stack[waiting + lane]
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
                    if reach < 0.9 * distance and distance > NEAREST:
                        rho = reach / distance
                        cube = r1[2] * r1[2] * (3.0 * radius + r0[3]) + radius * radius * (radius + 3.0 * r1[2])
                        bound = r1[0] / (left * left) * (4.0 - 3.0 * rho) * cube / (distance * distance * distance)
                    if bound <= tolerance:
                        field = add_node(field, load_rest(caps.moments, base + node, r0, r1), u, 1.0 / distance)
                        field.error = field.error + WIDER * bound + r1[1] / (left * left)
                        field.drift = field.drift + radius / distance * r1[0] / (left * left)
                        steps = steps + 1.0
                    elif node < leaves:
                        opened = bool(True)
                    elif radius > 0.0 and room == 0:
                        field.left_out = field.left_out + most_of(caps, base + node, centre, radius)
                        near = 1
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
                a, b, c = corners_from(caps, mesh, node - leaves, centre)
                angle, wrong = near_cap(a, b, c)
                t = Taylor()
                if radius > 0.0:
                    t = taylor_of_cap(a, b, c, radius * WIDER, angle, wrong)
                if t.bound <= tolerance:
                    field.value = field.value + wp.float64(angle)
                    field.slope = field.slope + t.slope
                    field.squares = field.squares + t.squares
                    field.products = field.products + t.products
                    field.error = field.error + wrong + WIDER * t.bound + t.rounding
                    field.drift = field.drift + t.drift
                    steps = steps + 1.0
                else:
                    field.left_out = field.left_out + most_of(caps, base + node, centre, radius)
                    listed = bool(True)
            mask = ballot(listed)
            if listed and near + members(mask) <= room:
                stack[STACK - 1 - near - rank(mask, lane)] = node - leaves
            near = near + members(mask)
        if ballot(field.error + wp.where(near > room, field.left_out, 0.0) >= HOPELESS) != wp.uint32(0):
            # Nothing will be known, as not all is added up.
            field.error = float(wp.inf)
            waiting = int(0)
            single = int(0)
        wait_for_lanes()
    field.error = sum_of_lanes(field.error + 4.0 * UNIT * (steps + 6.0) * field.drift)
    field.left_out = sum_of_lanes(field.left_out)
    if near <= room:
        field.near = near
    else:
        field.error = field.error + field.left_out
    field.value = sum_of_lanes_in_double(field.value)
    for axis in range(3):
        field.slope[axis] = sum_of_lanes(field.slope[axis])
        field.squares[axis] = sum_of_lanes(field.squares[axis])
        field.products[axis] = sum_of_lanes(field.products[axis])
    return field


@wp.func
def near_angle(caps: Caps, mesh: int, near: int, p: wp.vec3, stack: wp.array(dtype=wp.int32), lane: int, lanes: int):
    """A lane's part of the solid angle of the listed caps seen from p (scaled), and the largest error of it.

    As `near_cap`, but half angles add up as the arguments of a product of complex numbers, and a count of its full
    turns: a factor has an error of 15u more.
    """
    re = float(1.0)
    im = float(0.0)
    turns = float(0.0)
    error = float(0.0)
    i = lane
    while i < near:
        a, b, c = corners_from(caps, mesh, stack[STACK - 1 - i], p)
        f, v, size, least = cap_factor(a, b, c)
        most = wp.max(wp.abs(v), wp.abs(f))
        room = (ROUNDINGS * least + SNAP) * size
        if is_known(f, v, most, room, least):
            inverse = about_quotient(1.0, most)
            error = error + 2.0 * WIDER * about_quotient(room * inverse, least)
            x = f * inverse
            y = v * inverse
            new_re = re * x - im * y
            new_im = re * y + im * x
            if im >= 0.0 and y > 0.0 and new_im < 0.0:
                turns = turns + 1.0
            if im < 0.0 and y < 0.0 and new_im >= 0.0:
                turns = turns - 1.0
            # A factor is between 1 and 1.5: this is long before an overflow.
            shrink = wp.where(wp.abs(new_re) + wp.abs(new_im) > LARGEST_PRODUCT, 1.0 / LARGEST_PRODUCT, 1.0)
            re = shrink * new_re
            im = shrink * new_im
        else:
            error = float(wp.inf)
        i = i + lanes
    angle = 2.0 * wp.atan2(im, re) + FULL * turns
    return angle, error + 4.0 * UNIT * wp.abs(angle)


@wp.func
def near_share(caps: Caps, mesh: int, near: int, p: wp.vec3, stack: wp.array(dtype=wp.int32), lane: int, lanes: int):
    """The share of the listed caps of the winding number at p (scaled), and the largest error of it."""
    angle, error = near_angle(caps, mesh, near, p, stack, lane, lanes)
    angle = sum_of_lanes(angle)
    error = sum_of_lanes(error) + 8.0 * UNIT * FULL
    return angle / FULL, error / FULL


@wp.func
def share_at(field: Field, x: wp.vec3):
    """The caps' share of the winding number at x from the field's centre."""
    curved = wp.dot(field.squares, wp.cw_mul(x, x)) + field.products[0] * x[0] * x[1]
    curved = curved + field.products[1] * x[0] * x[2] + field.products[2] * x[1] * x[2]
    return (float(field.value) + wp.dot(field.slope, x) + curved) / FULL


@wp.func
def doubt(field: Field):
    """The largest error of that."""
    return field.error / FULL


@wp.func
def largest_share(field: Field, half: wp.vec3):
    """A bound of the caps' share all over a box of these half-widths."""
    slope = wp.dot(wp.abs(field.slope), half)
    curved = wp.dot(wp.abs(field.squares), wp.cw_mul(half, half)) + wp.abs(field.products[0]) * half[0] * half[1]
    curved = curved + wp.abs(field.products[1]) * half[0] * half[2] + wp.abs(field.products[2]) * half[1] * half[2]
    return (
        wp.abs(float(field.value)) + slope + curved + field.error + wp.where(field.near > 0, field.left_out, 0.0)
    ) / FULL
