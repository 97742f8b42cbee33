"""Taylor polynomial of the solid angle of one cap, by its edges: for caps that are large, and near for their size.

A cap's solid angle changes with the place by its edges alone (the law of Biot and Savart). With a and b the ways to an
edge's ends, its part of the gradient is

    a x b S,   S = (1/|a| + 1/|b|) / k,   k = |a||b| + a.b,

where S depends on the place: at x from the centre it is S + s.x + x.H x/2 + ..., and as the other factor, times x,
does not change along the way to x, the edge's part of the solid angle is that at the centre and

    (a x b).x (S + s.x/2 + x.H x/6 + ...).

With A = a/|a|, B = b/|b|, u = 1/|a|, v = 1/|b|, w = u + v and L = |a| + |b|

    s = (u^2 A + v^2 B)/k + w L/k^2 (A + B),
    H = p A A' + q (A B' + B A') + r B B' + t,
    q = (u^2 + v^2) L/k^2 + w/k^2 (2 L^2/k - 1),           t = -(u^3 + v^3)/k - w^2 L/k^2,
    p = 3 u^3/k + (3 u + v) u L/k^2 + w/k^2 (2 L^2/k - 1),   r the same with u and v exchanged.

The rest is bounded as that of a multipole is (`cap_field`): a derivative of order m of the solid angle is an integral
along the edges of derivatives of order m of 1/|r|, each at most m!/|r|^(m+1). With R the radius of the box and d the
distance of an edge of length l from its centre, the terms from the fourth order on add up to

    min(l/d, pi/2) rho^4 / (1 - rho),   rho = R/d.

All that holds if the cap itself does not pass through the ball around the box, where its solid angle jumps. Where the
cap does, the centre is less than R above the plane, and d or more from the rim, so that the solid angle there is at
least that of a disc, 2 pi (1 - R/d).

Rounding: in units of u = 2^-24 the product a x b is wrong by 6 |a||b|, and S by a share of 6 K + 10 with
K = |a||b|/k, where |a x b| is at most sqrt(2/K) |a||b|. All that is added up in H has one sign, but for t, and is wrong
by a share of 18 K + 30. Places on the lattice are up to 0.1 u away.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.fast_math import about_inverse_root, about_quotient, about_root
from sdm.kernels.primitives.lanes import unknown
from sdm.kernels.winding.cap_field import Field, cubes_of

wp.set_module_options({"enable_backward": False})

UNIT = 2.0**-24
# The nearest edge, in radii of the box, and the largest K: beyond that float32 tells too little.
NEAREST_EDGE = 2.0
LARGEST_RATIO = 1.0e4


@wp.func
def bend_of(ia: float, ib: float, both: float, ik: float):
    """p, q, r and t of an edge's S."""
    w = ia + ib
    once = both * ik * ik
    common = w * ik * ik * (2.0 * both * both * ik - 1.0)
    p = ia * (3.0 * ia * ia * ik + (3.0 * ia + ib) * once) + common
    q = (ia * ia + ib * ib) * once + common
    r = ib * (3.0 * ib * ib * ik + (3.0 * ib + ia) * once) + common
    return p, q, r, -(ia * ia * ia + ib * ib * ib) * ik - w * w * once


@wp.func
def bound_of_edge(a: wp.vec3, b: wp.vec3, radius: float):
    """Bound of what the polynomial of an edge from a to b leaves out, with places on the lattice, infinite if nothing
    is known; and the edge's least distance.
    """
    la = about_root(wp.dot(a, a))
    lb = about_root(wp.dot(b, b))
    along = b - a
    length2 = wp.dot(along, along)
    part = float(0.0)
    if length2 > 0.0:
        part = wp.clamp(-about_quotient(wp.dot(a, along), length2), 0.0, 1.0)
    way = a + part * along
    # Less than it is, by more than the rounding.
    d = 0.999 * about_root(wp.dot(way, way)) - 1.0e-6 * (la + lb)
    size = la * lb
    bound = float(wp.inf)
    if d > NEAREST_EDGE * radius and (size + wp.dot(a, b)) * LARGEST_RATIO > size:
        reach = wp.min(about_quotient(about_root(length2), d), 0.5 * wp.PI)
        rho = about_quotient(radius, d)
        bound = reach * about_quotient(rho * rho * rho * rho, 1.0 - rho) + 2.0 * UNIT * about_quotient(reach, d)
    return bound, d


@wp.func
def bound_of_cap(a: wp.vec3, b: wp.vec3, c: wp.vec3, radius: float, angle: float, wrong: float):
    """Bound of what the polynomial of a cap leaves out, with corners at a, b and c from the box's centre, where it is
    seen as that angle; infinite if nothing is known.
    """
    bound = float(0.0)
    nearest = float(wp.inf)
    p = a
    q = b
    r = c
    for _edge in range(unknown(3)):
        left_out, d = bound_of_edge(p, q, radius)
        bound = bound + left_out
        nearest = wp.min(nearest, d)
        first = p
        p = q
        q = r
        r = first
    if not wp.abs(angle) + wrong < 2.0 * wp.PI * (1.0 - about_quotient(radius, nearest)):
        bound = float(wp.inf)
    return bound


@wp.func
def may_be_expanded(r: float, distance: float, radius: float, tolerance: float):
    """False if the Taylor polynomial of a cap within r of its middle leaves out more than a tolerance for certain.

    Its longest edge is at least 1.5 r long, and nowhere nearer than its ends, which are no further than distance + r:
    that edge's bound is too large then (`bound_of_edge`).
    """
    near = about_quotient(1.0, distance + r)
    rho = radius * near
    return wp.min(1.49 * r * near, 1.5) * (rho * rho) * (rho * rho) <= tolerance


@wp.func
def add_edge(field: Field, a: wp.vec3, b: wp.vec3, radius: float):
    """Add to a field the polynomial of an edge from a to b, seen from the box's centre, without what it leaves out."""
    ia = about_inverse_root(wp.dot(a, a))
    ib = about_inverse_root(wp.dot(b, b))
    la = ia * wp.dot(a, a)
    lb = ib * wp.dot(b, b)
    size = la * lb
    ik = about_quotient(1.0, size + wp.dot(a, b))
    normal = wp.cross(a, b)
    s1 = (ia + ib) * ik
    both = s1 * (la + lb) * ik
    s = a * (ia * (ia * ia * ik + both)) + b * (ib * (ib * ib * ik + both))
    field.slope = field.slope + s1 * normal
    field.squares = field.squares + 0.5 * wp.cw_mul(normal, s)
    other = wp.vec3(
        normal[0] * s[1] + normal[1] * s[0],
        normal[0] * s[2] + normal[2] * s[0],
        normal[1] * s[2] + normal[2] * s[1],
    )
    field.products = field.products + 0.5 * other
    p, q, r, level = bend_of(ia, ib, la + lb, ik)
    flat = about_root(wp.dot(normal, normal))
    square = about_root(wp.dot(s, s)) * radius * radius
    change = s1 * radius + square + radius * radius * radius * (p + 2.0 * q + r - 3.0 * level) / 3.0
    field.drift = field.drift + change * flat
    field.error = field.error + UNIT * change * (20.0 * size + flat * (20.0 * size * ik + 40.0))
    fa = ia * a
    fb = ib * b
    ga = p * fa + q * fb
    gb = q * fa + r * fb
    squares = wp.cw_mul(ga, fa) + wp.cw_mul(gb, fb)
    sixth = normal / 6.0
    xy = 2.0 * (ga[0] * fa[1] + gb[0] * fb[1])
    xz = 2.0 * (ga[0] * fa[2] + gb[0] * fb[2])
    yz = 2.0 * (ga[1] * fa[2] + gb[1] * fb[2])
    field.cubes = field.cubes + cubes_of(sixth, level * sixth, squares, xy, xz, yz)
    return field


@wp.func
def add_cap(field: Field, a: wp.vec3, b: wp.vec3, c: wp.vec3, radius: float):
    """Add to a field the slope and all that follows of a cap with corners at a, b and c from the box's centre."""
    p = a
    q = b
    r = c
    for _edge in range(unknown(3)):
        field = add_edge(field, p, q, radius)
        first = p
        p = q
        q = r
        r = first
    return field
