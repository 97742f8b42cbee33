"""Which triangles can be nearest to some voxel of a cell: one test, valid for any convex set.

A cell has a centre c and half-widths a (of voxel centres, per axis). Let y be any known point of the surface, T a
convex set (a triangle, a box of triangles), u any vector, and s = min over T of (c - v).u: T lies behind the plane
at height s/|u| below c. At c + d, |d_i| <= a_i, the distance from T is at least that from the plane,
(s + d.u)/|u|, if that is positive; the distance from the surface is at most |c + d - y|. Squared and subtracted:

    s^2/|u|^2 + 2 (s/|u|^2) d.u + (d.u)^2/|u|^2  -  |c - y|^2 - 2 d.(c - y) - |d|^2
      >=  s^2/|u|^2 - |c - y|^2 - 2 sum_i a_i |(s/|u|^2) u - (c - y)|_i - sum_i a_i^2.

If the last line is positive and s > sum_i a_i |u_i|, no voxel of the cell is nearest to T, and T is dropped. The
best u points from T's closest point to c; a rounded one only weakens the test, never breaks it. Distance alone
(drop T if it is 2|a| further away than y) would keep every triangle of a surface that is nearly equidistant, as
most are from afar; the direction u tells apart what can be nearest within the cell from what cannot.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.frames import Frame, Local
from sdm.kernels.lanes import from_lane, lane_of_least
from sdm.kernels.rough import about_quotient, about_root

wp.set_module_options({"enable_backward": False})

# Relative room for rounding in the two squares, about 16 float32 roundings in each distance.
SLACK = wp.constant(2.0e-6)


@wp.struct
class Witness:
    """The surface point y known to be nearest to a cell's centre c."""

    to_surface: wp.vec3  # c - y
    distance2: float  # |c - y|^2, infinite if there is none


@wp.struct
class Cell:
    """A box of voxel centres."""

    centre: wp.vec3
    half: wp.vec3
    half2: float  # |half|^2


@wp.func
def no_witness():
    """Nothing known yet."""
    w = Witness()
    w.distance2 = float(wp.inf)
    return w


@wp.func
def is_behind(cell: Cell, known: Witness, u: wp.vec3, s: float):
    """Whether a convex set with min (c - v).u = s can be dropped for the cell."""
    if s <= wp.dot(cell.half, wp.vec3(wp.abs(u[0]), wp.abs(u[1]), wp.abs(u[2]))) * (1.0 + SLACK):
        return False
    share = about_quotient(s, wp.dot(u, u))
    far2 = s * share
    gap = share * u - known.to_surface
    spread = cell.half[0] * wp.abs(gap[0]) + cell.half[1] * wp.abs(gap[1]) + cell.half[2] * wp.abs(gap[2])
    return far2 - known.distance2 - 2.0 * spread - cell.half2 > SLACK * (far2 + known.distance2)


@wp.func
def box_is_behind(cell: Cell, known: Witness, low: wp.vec3, high: wp.vec3):
    """`is_behind` for a box."""
    c = cell.centre
    u = c - wp.vec3(wp.clamp(c[0], low[0], high[0]), wp.clamp(c[1], low[1], high[1]), wp.clamp(c[2], low[2], high[2]))
    # The closest point of a box is its lowest one along u.
    s = wp.dot(u, u)
    if s == 0.0 or low[0] > high[0]:
        return low[0] > high[0]
    return is_behind(cell, known, u, s)


@wp.func
def ball_is_behind(cell: Cell, known: Witness, ball: wp.vec4):
    """`is_behind` for a ball: its centre and its radius."""
    u = cell.centre - wp.vec3(ball[0], ball[1], ball[2])
    d2 = wp.dot(u, u)
    s = d2 - ball[3] * about_root(d2)
    return s > 0.0 and is_behind(cell, known, u, s)


@wp.func
def away(f: Frame, seen: Local):
    """The vector from the triangle's closest point to the point that was seen."""
    return seen.height * f.normal + (seen.x - seen.near_x) * f.x_axis + (seen.y - seen.near_y) * f.y_axis


@wp.func
def remember(mine: Witness, u: wp.vec3):
    """The nearer of a lane's witness and the surface point at -u from the centre."""
    d2 = wp.dot(u, u)
    if d2 < mine.distance2:
        mine.distance2 = d2
        mine.to_surface = u
    return mine


@wp.func
def moved(known: Witness, by: wp.vec3):
    """A witness as it is seen from a centre that is `by` further on."""
    if known.distance2 < float(wp.inf):
        return remember(no_witness(), known.to_surface + by)
    return known


@wp.func
def agree(mine: Witness, lane: int):
    """The nearest of all lanes' witnesses."""
    best = lane_of_least(mine.distance2, lane)
    known = Witness()
    known.distance2 = from_lane(mine.distance2, best)
    u = mine.to_surface
    known.to_surface = wp.vec3(from_lane(u[0], best), from_lane(u[1], best), from_lane(u[2], best))
    return known
