"""Hole caps: an open mesh's boundary matters only near its holes.

Every loop of boundary edges gets a cap: a fan of triangles from its middle. Surface and caps together are closed, so
their crossings count a whole number, and the surface's own winding number is that number less the caps' share, which
is their solid angle over 4 pi. What has to be right is on which side of 0.25, 0.5 and 0.75 a winding number lies: that
is sign and clearness. So where the share is less than a quarter at every voxel of a box, the whole number will do.
Two bounds tell (`View`), for voxels within R of the box's centre:

- A triangle of area A at a distance d or more fills at most A/d^2; summed over all caps.
- As long as no cap is met, the share changes with the place by the boundary alone, for the fans' spokes cancel: an edge
  of length l at a distance d or more adds at most l/d^2 to the solid angle's gradient (the law of Biot and Savart). So
  the share is that at the centre, give or take R times the sum of l/(4 pi d^2).

The first is the sharper one from afar, the second near a cap, where it tells apart what sees a hole at an angle, and
may tell the side even where the share is large.

Where neither will do, the share is worked out voxel by voxel in float32, with a bound of its error (`Sight`); float64
(see `boundary_term`) is asked only where that leaves the side in doubt.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, to_lattice
from sdm.kernels.geometry.triangle_distance import nearest_part, segment_distance2
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.primitives.lanes import ballot, sum_of_lanes
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.ray_crossings import covers, crossing_of

wp.set_module_options({"enable_backward": False})

# Less than a quarter, by more than the rounding of the sums.
LARGEST_SHARE = 0.249
# How much of a distance is left after rounding, which can take a thin triangle's plane for its edge.
SURE = 0.99
ROUNDING = 2.0e-6
# The errors of a triangle's half solid angle; see `Sight`.
ROUNDINGS = 100.0 * 2.0**-24
SNAP = 2.0 * 2.0**-24
# The running product is brought back to size long before it overflows: a factor is between 1 and 1.5.
LARGEST_PRODUCT = 1.0e9
# What float32 adds to a share's error when all is summed up.
LAST_ROUNDINGS = 2.0e-6


@wp.struct
class Sight:
    """The caps' share of the winding number at a point, as far as it is summed up, in float32.

    With a, b and c the vectors to a triangle's corners, half its solid angle is the argument of f + iv, where
    v = a.(b x c) and f = |a||b||c| + a.b|c| + b.c|a| + c.a|b| (van Oosterom and Strackee 1983). The arguments add up as
    those of a product of complex numbers and a count of its full turns.

    Errors, in units of s = |a||b||c| and u = 2^-24: a, b and c are differences of float32 numbers, each rounded once; v
    then has an error of at most 14u, f of at most 55u, the factor and the product have 15u more (s/|f + iv| is at least
    0.2). The places on the lattice, which are those that count, are up to 0.1u away: that moves f + iv by 1.3u over the
    least of the lengths. So the argument is right within (100u + 2u/least) s/|f + iv|, if that is small and the
    negative real axis, where it jumps by a turn, is further away; else all is in doubt.
    """

    re: float
    im: float
    turns: wp.int32
    least: float  # the least distance from a corner
    spread: float  # sum of s/|f + iv|, infinite if a triangle is in doubt


@wp.struct
class View:
    """The two bounds of the caps' share for a box of voxels."""

    filled: float  # by areas and distances
    share: float  # at the centre
    error: float  # how far it may be from that anywhere in the box; infinite if a cap may be met


@wp.func
def nothing_seen():
    sight = Sight()
    sight.re = float(1.0)
    sight.least = float(1.0)
    return sight


@wp.func
def see_cap(sight: Sight, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Add a triangle with corners at a, b and c from the point."""
    la = wp.length(a)
    lb = wp.length(b)
    lc = wp.length(c)
    size = la * lb * lc
    v = wp.dot(a, wp.cross(b, c))
    f = size + wp.dot(a, b) * lc + wp.dot(b, c) * la + wp.dot(c, a) * lb
    least = wp.min(la, wp.min(lb, lc))
    most = wp.max(wp.abs(v), wp.abs(f))
    room = (ROUNDINGS * least + SNAP) * size
    sure = most * least > 10.0 * room and (f > 0.0 or wp.abs(v) * least > room)
    # A product of lengths that underflows is in doubt; so is what overflows, or is not a number.
    inverse = 1.0 / most
    x = f * inverse
    y = v * inverse
    re = sight.re * x - sight.im * y
    im = sight.re * y + sight.im * x
    if sight.im >= 0.0 and y > 0.0 and im < 0.0:
        sight.turns = sight.turns + 1
    if sight.im < 0.0 and y < 0.0 and im >= 0.0:
        sight.turns = sight.turns - 1
    if wp.abs(re) + wp.abs(im) > LARGEST_PRODUCT:
        re = re / LARGEST_PRODUCT
        im = im / LARGEST_PRODUCT
    sight.re = re
    sight.im = im
    sight.least = wp.min(sight.least, least)
    sight.spread = wp.where(sure, sight.spread + size * inverse, float(wp.inf))
    return sight


@wp.func
def share_of_turn(sight: Sight):
    """The share seen, without its whole `turns`."""
    return wp.atan2(sight.im, sight.re) / (2.0 * wp.PI)


@wp.func
def doubt(sight: Sight):
    """The largest error of the share seen."""
    return (ROUNDINGS + SNAP / sight.least) * sight.spread / (2.0 * wp.PI)


@wp.func
def see_caps(boundary: Boundary, mesh: int, p: wp.vec3, lane: int, lanes: int):
    """A lane's part of all caps, seen from p (scaled)."""
    sight = nothing_seen()
    e = lane
    while e < boundary.count:
        edge = mesh * boundary.count + e
        sight = see_cap(sight, boundary.ends[2 * edge + 1] - p, boundary.ends[2 * edge] - p, boundary.apexes[edge] - p)
        e = e + lanes
    return sight


@wp.func
def view_caps(boundary: Boundary, mesh: int, box: VoxelBox, lane: int, lanes: int):
    """All caps, seen from a box."""
    radius = wp.sqrt(box.half2)
    sight = nothing_seen()
    view = View()
    e = lane
    while e < boundary.count and wp.min(view.filled, view.error) < LARGEST_SHARE:
        edge = mesh * boundary.count + e
        a = boundary.ends[2 * edge + 1]
        b = boundary.ends[2 * edge]
        c = boundary.apexes[edge]
        across = wp.cross(b - a, c - a)
        area2 = wp.length(across)
        if area2 > 0.0:
            across = across / area2
        d2, _part = nearest_part(box.centre, a, b, c, across)
        gap = SURE * wp.sqrt(d2) - ROUNDING - radius
        rim = SURE * wp.sqrt(segment_distance2(box.centre - a, b - a)) - ROUNDING - radius
        if gap > 0.0 and rim > 0.0:
            view.filled = view.filled + area2 / (8.0 * wp.PI * gap * gap)
            view.error = view.error + radius * wp.length(b - a) / (4.0 * wp.PI * rim * rim)
            sight = see_cap(sight, a - box.centre, b - box.centre, c - box.centre)
            e = e + lanes
        else:
            view.filled = float(wp.inf)
            view.error = float(wp.inf)
    if e < boundary.count:
        # Neither bound will do, and not all was seen.
        view.error = float(wp.inf)
    view.filled = sum_of_lanes(view.filled)
    view.error = sum_of_lanes(view.error + doubt(sight))
    view.share = sum_of_lanes(share_of_turn(sight) + float(sight.turns))
    return view


@wp.func
def is_far(view: View):
    """True if the caps' share of the winding number is less than a quarter at every voxel of a box."""
    return view.filled < LARGEST_SHARE or wp.abs(view.share) + view.error < LARGEST_SHARE


@wp.func
def is_sure(winding: float, error: float):
    """True if a winding number is on a known side of the values that decide about sign and clearness."""
    off = wp.min(wp.abs(winding - 0.25), wp.min(wp.abs(winding - 0.5), wp.abs(winding - 0.75)))
    return off > error + LAST_ROUNDINGS


@wp.func
def cap_lattice(boundary: Boundary, tree: Tree, edge: int, mesh: int):
    """The (y,z) of a cap's triangle on the lattice: the edge backwards, then its apex."""
    apex = boundary.apexes[edge]
    top = to_lattice(tree, mesh, wp.float64(apex[1]), wp.float64(apex[2]))
    return boundary.lattice[2 * edge + 1], boundary.lattice[2 * edge], top


@wp.func
def may_cover(boundary: Boundary, mesh: int, box: VoxelBox, lane: int, lanes: int):
    """True if a line along x through a box may meet a cap: their shadows along x overlap, with some room."""
    meets = bool(False)
    e = lane
    while e < boundary.count:
        edge = mesh * boundary.count + e
        a = boundary.ends[2 * edge + 1]
        b = boundary.ends[2 * edge]
        c = boundary.apexes[edge]
        low = wp.min(a, wp.min(b, c)) - box.centre - box.half
        high = wp.max(a, wp.max(b, c)) - box.centre + box.half
        room = ROUNDING * (1.0 + wp.abs(box.centre[1]) + wp.abs(box.centre[2]))
        meets = meets or (low[1] <= room and high[1] >= -room and low[2] <= room and high[2] >= -room)
        e = e + lanes
    return ballot(meets) != wp.uint32(0)


@wp.func
def count_caps(boundary: Boundary, tree: Tree, mesh: int, p: wp.vec3d, lane: int, lanes: int):
    """A lane's part of the signed crossings of the ray from p (scaled) along +x with all caps."""
    q = to_lattice(tree, mesh, p[1], p[2])
    total = int(0)
    e = lane
    while e < boundary.count:
        edge = mesh * boundary.count + e
        a, b, c = cap_lattice(boundary, tree, edge, mesh)
        sign = covers(a, b, c, q)
        if sign != 0:
            x = crossing_of(
                a, b, c, boundary.ends[2 * edge + 1][0], boundary.ends[2 * edge][0], boundary.apexes[edge][0], q
            )
            if x > p[0]:
                total = total + sign
        e = e + lanes
    return total
