"""Solid angles of single near caps, one by one: exactly, with the largest error of float32."""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import first_triangle, tree_of
from sdm.kernels.primitives.fast_math import about_quotient, about_root
from sdm.kernels.primitives.lanes import sum_of_lanes
from sdm.kernels.winding.cap_tree import Caps

wp.set_module_options({"enable_backward": False})

FULL = 4.0 * wp.PI
# Room for the rounding of a bound.
WIDER = 1.0001
UNIT = 2.0**-24
# The errors of a near cap's half solid angle, see `near_cap`.
ROUNDINGS = 100.0 * UNIT
LARGEST_PRODUCT = 1.0e9
SNAP = 2.0 * UNIT
# The place in a large stack where near caps are listed, and on a GPU the room there for each lane of a part.
NEAR_LIST = 768
NEAR_EACH = 20


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
def place_of_cap(caps: Caps, mesh: int, leaf: int):
    """The place of the first corner of the cap in a leaf of a mesh's tree, by which near caps are listed."""
    one = tree_of(caps.tree, mesh)
    return 4 * (one.first + first_triangle(one, leaf))


@wp.func
def corners_from(caps: Caps, place: int, p: wp.vec3):
    """The ways from p (scaled) to the corners of the cap whose first one is at a place."""
    return caps.tree.corners[place] - p, caps.tree.corners[place + 1] - p, caps.tree.corners[place + 2] - p


@wp.func
def near_list_of(lane: int, some: int):
    """The place in a large stack where a lane's part of a group, of so many neighbours, lists near caps."""
    return NEAR_LIST + NEAR_EACH * (lane - (lane & (some - 1)))


@wp.func
def near_angle(caps: Caps, near: int, p: wp.vec3, stack: wp.array(dtype=wp.int32), at: int, lane: int, lanes: int):
    """A lane's part of the solid angle of the caps listed at a place, seen from p (scaled), and the error it may have.

    As `near_cap`, but half angles add up as the arguments of a product of complex numbers, and a count of its full
    turns: a factor has an error of 15u more.
    """
    re = float(1.0)
    im = float(0.0)
    turns = float(0.0)
    error = float(0.0)
    i = lane
    while i < near:
        a, b, c = corners_from(caps, stack[at + i], p)
        f, v, size, least = cap_factor(a, b, c)
        most = wp.max(wp.abs(v), wp.abs(f))
        room = (ROUNDINGS * least + SNAP) * size
        if is_known(f, v, most, room, least):
            inverse = about_quotient(1.0, most * least)
            error = error + 2.0 * WIDER * (room * inverse)
            x = f * (inverse * least)
            y = v * (inverse * least)
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
def near_share(caps: Caps, near: int, p: wp.vec3, stack: wp.array(dtype=wp.int32), lane: int, lanes: int):
    """The share of the listed caps of the winding number at p (scaled), and the largest error of it."""
    angle, error = near_angle(caps, near, p, stack, NEAR_LIST, lane, lanes)
    angle = sum_of_lanes(angle)
    error = sum_of_lanes(error) + 8.0 * UNIT * FULL
    return angle / FULL, error / FULL
