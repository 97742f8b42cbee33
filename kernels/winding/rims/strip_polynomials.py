"""Taylor polynomials of the strips of boundary edges over a box of voxels, for those that are far.

A strip (`boundary_term`) has an edge and two half lines along -x for its sides. Its share changes with the place by
these alone (Biot and Savart), where it does not jump: so it is far if all three, and what is between them, are far.

As each edge begins where another ends, the half lines of all edges cancel, and those of the far ones are those of the
others turned round; of these only what is far, as an edge with a near half line is not far at either side of it.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.primitives.lanes import ballot, members, rank, unknown, wait_for_lanes
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.cap_descent import sum_of_parts
from sdm.kernels.winding.cap_field import Field, cubes_of
from sdm.kernels.winding.cap_taylor import Taylor, add_edge
from sdm.kernels.winding.near_caps import UNIT, WIDER

wp.set_module_options({"enable_backward": False})

# More than rounding takes from the distance of a strip, in shares of the ends' distances.
STRIP_ROOM = 1.0e-6
# The integral of 1/r^5 along a line at a distance of 1, and a rounding more.
WHOLE = 1.3334


@wp.func
def strip_misses(a: wp.vec3, b: wp.vec3, radius: float):
    """True if the strip of an edge whose ends are a and b off does not come within a radius."""
    along_y = b[1] - a[1]
    along_z = b[2] - a[2]
    length2 = along_y * along_y + along_z * along_z
    part = float(0.0)
    if length2 > 0.0:
        part = wp.clamp(-(a[1] * along_y + a[2] * along_z) / length2, 0.0, 1.0)
    y = a[1] + part * along_y
    z = a[2] + part * along_z
    x = wp.min(wp.max(a[0], b[0]), 0.0)
    room = radius * WIDER + STRIP_ROOM * (1.0 + wp.length(a) + wp.length(b))
    return x * x + y * y + z * z > room * room


@wp.func
def half_line(a: wp.vec3, sense: float, radius: float):
    """Taylor polynomial of a half line from a way off along -x: `cap_taylor.add_edge` for an end without end.

    With h = (-1, 0, 0), A = a/|a|, u = 1/|a| and k = |a| + a.h, and each of k, and of what is added up, right within 16
    and 120 roundings of itself, S = u/k, s = u^2 A/k + u (A + h)/k^2, and H has

        p = 3 u^3/k + 3 u^2/k^2 + r,   q = u^2/k^2 + r,   r = 2 u/k^3,   t = -u^3/k - u^2/k^2.

    The terms of the order m = 4 and more are at most the integral of R^m/r^(m+1) along it, which is 4/3 rho^m of a
    whole line, and half of that where it leads away.
    """
    t = Taylor()
    aside2 = a[1] * a[1] + a[2] * a[2]
    la = wp.sqrt(a[0] * a[0] + aside2)
    k = la + wp.abs(a[0])
    d = la
    if a[0] > 0.0:
        k = aside2 / k
        d = wp.sqrt(aside2)
    d = 0.999 * d - 1.0e-6 * la
    t.bound = float(wp.inf)
    if d > 2.0 * radius and k > 0.0:
        rho = radius / d
        t.bound = wp.where(a[0] > 0.0, WHOLE, 0.5 * WHOLE) * (rho * rho * rho * rho) / (1.0 - rho)
        u = 1.0 / la
        ik = 1.0 / k
        h = wp.vec3(-1.0, 0.0, 0.0)
        along = u * a
        normal = sense * wp.cross(a, h)
        s1 = u * ik
        s = (u * s1) * along + (s1 * ik) * (along + h)
        r = 2.0 * s1 * ik * ik
        p = 3.0 * u * s1 * (u + ik) + r
        q = s1 * s1 + r
        level = -u * s1 * (u + ik)
        t.slope = s1 * normal
        t.squares = 0.5 * wp.cw_mul(normal, s)
        t.products = 0.5 * wp.vec3(
            normal[0] * s[1] + normal[1] * s[0],
            normal[0] * s[2] + normal[2] * s[0],
            normal[1] * s[2] + normal[2] * s[1],
        )
        ga = p * along + q * h
        gb = q * along + r * h
        squares = wp.cw_mul(ga, along) + wp.cw_mul(gb, h)
        sixth = normal / 6.0
        xy = 2.0 * (ga[0] * along[1] + gb[0] * h[1])
        xz = 2.0 * (ga[0] * along[2] + gb[0] * h[2])
        yz = 2.0 * (ga[1] * along[2] + gb[1] * h[2])
        t.cubes = cubes_of(sixth, level * sixth, squares, xy, xz, yz)
        flat = wp.sqrt(aside2)
        square = wp.length(s) * radius * radius
        cubic = radius * radius * radius * (p + 2.0 * q + r - 3.0 * level) / 3.0
        t.drift = (s1 * radius + square + cubic) * flat
        t.rounding = UNIT * (120.0 * t.drift + 4.0 * wp.PI / d)
    return t


@wp.func
def half_line_is_far(a: wp.vec3, radius: float, tolerance: float):
    """True if a half line's polynomial leaves out no more than a tolerance: the same for all edges that end there."""
    aside2 = a[1] * a[1] + a[2] * a[2]
    if a[0] <= 0.0:
        aside2 = aside2 + a[0] * a[0]
    d = 0.999 * wp.sqrt(aside2) - 1.0e-6 * wp.length(a)
    rho = radius / d
    reach = wp.where(a[0] > 0.0, WHOLE, 0.5 * WHOLE)
    return d > 2.0 * radius and reach * (rho * rho * rho * rho) <= tolerance * (1.0 - rho)


@wp.func
def with_polynomial(field: Field, t: Taylor):
    """A field and a polynomial."""
    field.slope = field.slope + t.slope
    field.squares = field.squares + t.squares
    field.products = field.products + t.products
    field.cubes = field.cubes + t.cubes
    field.error = field.error + WIDER * t.bound + t.rounding
    field.drift = field.drift + t.drift
    return field


@wp.struct
class Seen:
    """The field of the far edges for a box, and the others."""

    field: Field
    near: wp.int32  # edges that are not far


@wp.func
def see_edges(
    boundary: Boundary,
    first: int,
    count: int,
    listed: int,
    box: VoxelBox,
    tolerance: float,
    stack: wp.array(dtype=wp.int32),
    start: int,
    place: int,
    room: int,
    begin: Field,
    lane: int,
    lanes: int,
):
    """Add the polynomials of all edges that are far for a box to a field, and list the others in the stack.

    Args:
        boundary: The edges.
        first: The first of them.
        count: How many are looked at.
        listed: 1 if these are listed in the stack, from `start` on.
        box: The box, its voxels within the root of `half2` from its centre.
        tolerance: The largest bound of what an edge's polynomial leaves out.
        stack: Of this group.
        start: See above.
        place: Where in the stack those that are not far go.
        room: For them; if there are more, the error is infinite.
        begin: The field.
        lane: This lane's number.
        lanes: Their number.
    """
    radius = wp.sqrt(box.half2) * WIDER
    seen = Seen()
    if lane == 0:
        seen.field = begin
    steps = float(0.0)
    near = int(0)
    i = lane
    while i - lane < count and near <= room:
        other = bool(False)
        edge = first + i
        if i < count:
            if listed != 0:
                edge = stack[start + i]
            a = boundary.ends[2 * edge] - box.centre
            b = boundary.ends[2 * edge + 1] - box.centre
            t = Taylor()
            t.nearest = float(wp.inf)
            t = add_edge(t, a, b, radius)
            other = not (t.bound <= tolerance and strip_misses(a, b, radius))
            # Both ends before it is known whether any counts, one after the other, as a GPU keeps few instructions.
            for end in range(unknown(2)):
                if not half_line_is_far(wp.where(end == 0, a, b), radius, tolerance):
                    other = bool(True)
            if not other:
                seen.field = with_polynomial(seen.field, t)
                steps = steps + 1.0
            if other == (listed == 0):
                for end in range(unknown(2)):
                    # That of the first end counts against, and all turned round of the others.
                    way = wp.where(end == 0, a, b)
                    sense = wp.where((end == 0) == other, 1.0, -1.0)
                    if not other or half_line_is_far(way, radius, tolerance):
                        seen.field = with_polynomial(seen.field, half_line(way, sense, radius))
                        steps = steps + 1.0
        mask = ballot(other)
        if other and near + rank(mask, lane) < room:
            stack[place + near + rank(mask, lane)] = edge
        near = near + members(mask)
        i = i + lanes
    seen.field.error = seen.field.error + 4.0 * UNIT * (steps + 6.0) * seen.field.drift
    if near > room:
        seen.field.error = float(wp.inf)
    seen.field = sum_of_parts(seen.field, lanes, True)
    seen.near = near
    wait_for_lanes()
    return seen
