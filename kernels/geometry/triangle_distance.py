"""Distance to one triangle: a fast float32 form to search with, a float64 form to finish with.

Both take the minimum over the three edges (as segments) and, where the point projects into the triangle, its plane.
Unlike the usual cascade over Voronoi regions this has no division by the area, so it stays right on slivers, collinear
and repeated vertices, with two cares. Let h be a triangle's height over its longest edge, of length L, in scaled
coordinates: they are at most 1, so that one of them rounds by u = 2^-24, and a distance may be wrong by 2u.

**Flat triangles** (h <= FLATTEST max(1, L)) have no plane, and their edges tell all: every point of the triangle is
within h/2 of an edge, which is less than half a rounding.

**Sharp corners.** In float32 a point p at a distance d may seem to be on the inner side of an edge's line if it is
within r = 9u(L + d) of it: a rounding each of p - a, b - a and the normal, three in the cross product and three in the
dot product. Beside an edge that changes the distance by no more than r, for any triangle. But beyond a corner of angle
A the point may be on the outer side of two lines and r from both, that is r/sin(A/2) from the corner, for a sliver half
an edge away, and there the height over the plane would stand alone. So a point that is in a corner's Voronoi region, by
its projections on the two edges that meet there, is not above the triangle. No point of a triangle is: the angles
between the way from the corner to it and the two edges add up to A, less than 180 degrees. The projections are right
but for 5u(L + d) along the edge. Then a point that passes all tests projects on one edge of each corner, from within it
or less than that before its end, so it is beside that edge: r from its line on the outer side, or on the inner side and
r from the other edge's line, so that it is at most r/cos(A) <= 2r away for corners of up to 60 degrees, and r/sin(A/2)
<= 2r for others.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.fast_math import inverse_root

wp.set_module_options({"enable_backward": False})

# See above.
FLATTEST = wp.float64(2.0**-26)


@wp.func
def nearest_of_segment(q: wp.vec3, e: wp.vec3):
    """Parameter, from 0 to 1, of the point of the segment 0..e nearest to q, and the squared distance."""
    t = float(0.0)
    length2 = wp.dot(e, e)
    if length2 > 0.0:
        t = wp.clamp(wp.dot(q, e) / length2, 0.0, 1.0)
    r = q - t * e
    return t, wp.dot(r, r)


@wp.func
def segment_distance2(q: wp.vec3, e: wp.vec3):
    """Squared distance of q from the segment 0..e."""
    _t, d2 = nearest_of_segment(q, e)
    return d2


@wp.func
def nearest_part(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3, n: wp.vec3):
    """Squared distance of p from the triangle (a,b,c), and what of it is nearest: plane (0), ab (1), bc (2) or ca (3).

    n is the unit normal, or zero if the triangle is flat (see above). It comes from float64, so that the height over a
    sliver is as accurate as over any triangle.
    """
    pa = p - a
    pb = p - b
    pc = p - c
    ab = b - a
    bc = c - b
    ca = a - c
    t_ab, d2 = nearest_of_segment(pa, ab)
    part = int(1)
    t_bc, other2 = nearest_of_segment(pb, bc)
    if other2 < d2:
        d2 = other2
        part = int(2)
    t_ca, other2 = nearest_of_segment(pc, ca)
    if other2 < d2:
        d2 = other2
        part = int(3)
    inside_ab = wp.dot(wp.cross(n, ab), pa) >= 0.0
    inside_bc = wp.dot(wp.cross(n, bc), pb) >= 0.0
    inside_ca = wp.dot(wp.cross(n, ca), pc) >= 0.0
    # In a corner's Voronoi region it is the nearest of both edges that meet there.
    beyond_a = t_ca == 1.0 and t_ab == 0.0
    beyond_b = t_ab == 1.0 and t_bc == 0.0
    beyond_c = t_bc == 1.0 and t_ca == 0.0
    beyond = beyond_a or beyond_b or beyond_c
    if inside_ab and inside_bc and inside_ca and not beyond and wp.dot(n, n) > 0.5:
        h = wp.dot(n, pa)
        d2 = h * h
        part = int(0)
    return d2, part


@wp.func
def longest_edge2(ab: wp.vec3d, bc: wp.vec3d, ca: wp.vec3d):
    """The square of the longest of three edges."""
    return wp.max(wp.dot(ab, ab), wp.max(wp.dot(bc, bc), wp.dot(ca, ca)))


@wp.func
def unit_normal(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Unit normal of a triangle in scaled coordinates, or zero if it is flat: if its edges tell all (see above)."""
    ab = b - a
    ca = a - c
    n = wp.cross(ab, -ca)
    n2 = wp.dot(n, n)
    longest2 = longest_edge2(ab, c - b, ca)
    if n2 <= FLATTEST * FLATTEST * longest2 * wp.max(longest2, wp.float64(1.0)):
        return wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(0.0))
    return inverse_root(n2) * n


@wp.struct
class Hit:
    """The closest point of one triangle."""

    point: wp.vec3d
    barycentric: wp.vec3d
    distance2: wp.float64


@wp.func
def segment_parameter(q: wp.vec3d, e: wp.vec3d):
    """Parameter, from 0 to 1, of the point of the segment 0..e that is closest to q."""
    length2 = wp.dot(e, e)
    if length2 > wp.float64(0.0):
        return wp.clamp(wp.dot(q, e) / length2, wp.float64(0.0), wp.float64(1.0))
    return wp.float64(0.0)


@wp.func
def part_distance2(part: int, p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Squared distance of p from the plane or an edge of a triangle (see `nearest_part`), in float64."""
    if part == 0:
        n = wp.cross(b - a, c - a)
        h = wp.dot(n, p - a)
        return h * h / wp.dot(n, n)
    start = a
    edge = b - a
    if part == 2:
        start = b
        edge = c - b
    if part == 3:
        start = c
        edge = a - c
    r = p - start
    r = r - segment_parameter(r, edge) * edge
    return wp.dot(r, r)


@wp.func
def closest_point(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """The point of the triangle (a,b,c) closest to p, its barycentric coordinates and squared distance, in float64."""
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    pa = p - a
    ab = b - a
    bc = c - b
    ca = a - c
    hit = Hit()

    t = segment_parameter(pa, ab)
    r = pa - t * ab
    hit.distance2 = wp.dot(r, r)
    hit.barycentric = wp.vec3d(one - t, t, zero)

    pb = p - b
    t = segment_parameter(pb, bc)
    r = pb - t * bc
    d2 = wp.dot(r, r)
    if d2 < hit.distance2:
        hit.distance2 = d2
        hit.barycentric = wp.vec3d(zero, one - t, t)

    pc = p - c
    t = segment_parameter(pc, ca)
    r = pc - t * ca
    d2 = wp.dot(r, r)
    if d2 < hit.distance2:
        hit.distance2 = d2
        hit.barycentric = wp.vec3d(t, zero, one - t)

    n = unit_normal(a, b, c)
    if wp.dot(n, n) > wp.float64(0.5):
        weight_c = wp.dot(n, wp.cross(ab, pa))
        weight_a = wp.dot(n, wp.cross(bc, pb))
        weight_b = wp.dot(n, wp.cross(ca, pc))
        if weight_a >= zero and weight_b >= zero and weight_c >= zero:
            h = wp.dot(n, pa)
            if h * h < hit.distance2:
                hit.distance2 = h * h
                hit.barycentric = wp.vec3d(weight_a, weight_b, weight_c) / (weight_a + weight_b + weight_c)

    w = hit.barycentric
    hit.point = w[0] * a + w[1] * b + w[2] * c
    return hit


@wp.func
def solid_angle(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Signed solid angle of a triangle seen from the origin (van Oosterom and Strackee 1983), positive from inside."""
    la = wp.length(a)
    lb = wp.length(b)
    lc = wp.length(c)
    numerator = wp.dot(a, wp.cross(b, c))
    denominator = la * lb * lc + wp.dot(a, b) * lc + wp.dot(b, c) * la + wp.dot(c, a) * lb
    return wp.float64(2.0) * wp.atan2(numerator, denominator)
