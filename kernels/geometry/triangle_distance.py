"""Distance to one triangle: a fast float32 form to search with, a float64 form to finish with.

Both take the minimum over the three edges (as segments) and, where the point projects into the triangle, its
plane. Unlike the usual cascade over Voronoi regions this has no division by the area, so it stays right on
slivers, collinear and repeated vertices: a wrong answer to "does it project inside?" near an edge changes the
distance by no more than the rounding that caused it, because the edge itself is always in the minimum.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.fast_math import inverse_root

wp.set_module_options({"enable_backward": False})

# Below this height over longest edge a triangle is as thin as float32 rounding of its own corners: its edges tell all.
FLATTEST = wp.float64(1.0e-10)


@wp.func
def segment_distance2(q: wp.vec3, e: wp.vec3):
    """Squared distance of q from the segment 0..e."""
    t = float(0.0)
    length2 = wp.dot(e, e)
    if length2 > 0.0:
        t = wp.clamp(wp.dot(q, e) / length2, 0.0, 1.0)
    r = q - t * e
    return wp.dot(r, r)


@wp.func
def nearest_part(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3, n: wp.vec3):
    """Squared distance of p from the triangle (a,b,c), and what of it is nearest: plane (0), ab (1), bc (2) or ca (3).

    n is the unit normal, zero if the triangle has no area. It comes from float64, so that the height over a sliver is
    as accurate as over any triangle.
    """
    pa = p - a
    pb = p - b
    pc = p - c
    ab = b - a
    bc = c - b
    ca = a - c
    inside_ab = wp.dot(wp.cross(n, ab), pa) >= 0.0
    inside_bc = wp.dot(wp.cross(n, bc), pb) >= 0.0
    inside_ca = wp.dot(wp.cross(n, ca), pc) >= 0.0
    d2 = float(0.0)
    part = int(0)
    if inside_ab and inside_bc and inside_ca and wp.dot(n, n) > 0.5:
        h = wp.dot(n, pa)
        d2 = h * h
    else:
        d2 = segment_distance2(pa, ab)
        part = int(1)
        other2 = segment_distance2(pb, bc)
        if other2 < d2:
            d2 = other2
            part = int(2)
        other2 = segment_distance2(pc, ca)
        if other2 < d2:
            d2 = other2
            part = int(3)
    return d2, part


@wp.func
def unit_normal(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Unit normal of a triangle, or zero if it has no area to speak of."""
    ab = b - a
    bc = c - b
    ca = a - c
    n = wp.cross(ab, -ca)
    n2 = wp.dot(n, n)
    least = FLATTEST * wp.max(wp.dot(ab, ab), wp.max(wp.dot(bc, bc), wp.dot(ca, ca)))
    if n2 <= least * least:
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
        weight_c = wp.dot(wp.cross(n, ab), pa)
        weight_a = wp.dot(wp.cross(n, bc), pb)
        weight_b = wp.dot(wp.cross(n, ca), pc)
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
