"""Witness bound: the points that can be nearest to some voxel of a box, by one test for points, triangles and nodes.

A box has a centre c and half-widths a (of voxel centres, per axis). Let y be any known point of the surface, the
witness. A point x is nearer to a voxel p than y only where

    D(p, x) = |p - x|^2 - |p - y|^2 < 0.

The square of p cancels, so D is linear in p, and its least value over the box is exactly

    |c - x|^2 - |c - y|^2 - 2 sum_i a_i |x_i - y_i|.

If that is positive, x is nearest to no voxel of the box. From this:

- A segment or a triangle. Let x = sum_j l_j x_j be a mean of its corners. |p - x|^2 is the same mean of |p - x_j|^2,
  less the sum over pairs of corners of l_j l_k |x_j - x_k|^2. So D(p, x) is at least the least D(p, x_j) of its
  corners, less L^2/4 for two corners and L^2/3 for three, with L the longest edge.
- A node's box. D is a sum over the axes of (p_i - x_i)^2 - (p_i - y_i)^2. The least over all x_i from low to high is
  e^2 - (p_i - y_i)^2, with e how far p_i is from that interval. As a function of p_i this is concave (e^2 curves up at
  most as much as the other square curves down), so its least is at one of the box's two ends. The test is exact.

Distance alone (drop what is 2|a| further from c than y) would keep every triangle of a surface that is nearly
equidistant, as most are from afar; D knows directions, since x_i - y_i is small for the points that remain.

Nothing here asks more of a triangle than its corners: slivers and soups are treated like all others.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.triangle_frames import Frame, Local
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.primitives.lanes import from_lane, lane_of_least
from sdm.kernels.primitives.vector_loads import load4, read4, write4

wp.set_module_options({"enable_backward": False})

# Relative room for rounding in D, of the squares that it is a difference of: about 64 float32 roundings.
SLACK = 4.0e-6
# Twice how far rounding may have put a witness off the surface, in units of the mesh's diagonal.
OFF_SURFACE = 1.0e-6
# Squares beyond this one may overflow.
LARGEST_SQUARE = 1.0e36


@wp.struct
class Witness:
    """The surface point y known to be nearest to a box's centre c."""

    to_surface: wp.vec3  # c - y
    distance2: float  # |c - y|^2, infinite if there is none


@wp.func
def no_witness():
    """Nothing known yet."""
    w = Witness()
    w.distance2 = float(wp.inf)
    return w


@wp.func
def sum_abs(u: wp.vec3):
    return wp.abs(u[0]) + wp.abs(u[1]) + wp.abs(u[2])


@wp.func
def reach(half: wp.vec3, u: wp.vec3):
    """The largest d.u over the box |d_i| <= half_i."""
    return half[0] * wp.abs(u[0]) + half[1] * wp.abs(u[1]) + half[2] * wp.abs(u[2])


@wp.func
def doubt(box: VoxelBox, known: Witness):
    """Error bound of D over the box; infinite without a witness, or where squares may overflow."""
    squares = known.distance2 + box.half2
    away = sum_abs(known.to_surface) + box.half[0] + box.half[1] + box.half[2]
    return wp.where(squares < LARGEST_SQUARE, SLACK * squares + OFF_SURFACE * box.diagonal * away, float(wp.inf))


@wp.func
def least_lead(box: VoxelBox, known: Witness, q: wp.vec3):
    """The least D over the box of the point that is at q from its centre."""
    return wp.dot(q, q) - known.distance2 - 2.0 * reach(box.half, q + known.to_surface)


@wp.func
def lead_along(low: float, high: float, y: float, half: float):
    """One axis of the least D of a node's box; all from the box's centre."""
    below = wp.max(wp.max(low + half, -half - high), 0.0)
    above = wp.max(wp.max(low - half, half - high), 0.0)
    return wp.min(below * below - (half + y) * (half + y), above * above - (half - y) * (half - y))


@wp.func
def box_is_farther(box: VoxelBox, known: Witness, low: wp.vec3, high: wp.vec3):
    """True if no point of a node's box is nearer to any voxel of the box than the witness."""
    if low[0] > high[0]:
        return True
    a = low - box.centre
    b = high - box.centre
    y = -known.to_surface
    lead = lead_along(a[0], b[0], y[0], box.half[0])
    lead = lead + lead_along(a[1], b[1], y[1], box.half[1])
    lead = lead + lead_along(a[2], b[2], y[2], box.half[2])
    return lead > doubt(box, known)


@wp.func
def triangle_is_farther(box: VoxelBox, known: Witness, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """True if no point of a triangle is nearer to any voxel of the box than the witness."""
    lead = wp.min(
        least_lead(box, known, a - box.centre),
        wp.min(least_lead(box, known, b - box.centre), least_lead(box, known, c - box.centre)),
    )
    return lead > bulge_of_triangle(b - a, c - b, a - c) + doubt(box, known)


@wp.func
def bulge_of_edge(ab: wp.vec3):
    """Bound on how much less D is inside of an edge than at its ends."""
    return 0.250001 * wp.dot(ab, ab)


@wp.func
def bulge_of_triangle(ab: wp.vec3, bc: wp.vec3, ca: wp.vec3):
    """Bound on how much less D is inside of a triangle than at its corners."""
    return 0.333334 * wp.max(wp.dot(ab, ab), wp.max(wp.dot(bc, bc), wp.dot(ca, ca)))


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


@wp.func
def write_witness(rows: wp.array(dtype=wp.float32), number: int, known: Witness):
    """Write witness `number` of rows of four."""
    u = known.to_surface
    write4(rows, number, u[0], u[1], u[2], known.distance2)


@wp.func
def witness_in(row: wp.vec4):
    """The witness in a row of four."""
    known = Witness()
    known.to_surface = wp.vec3(row[0], row[1], row[2])
    known.distance2 = row[3]
    return known


@wp.func
def read_witness(rows: wp.array(dtype=wp.float32), number: int):
    """Witness `number` of rows of four, written before."""
    return witness_in(load4(rows, number))


@wp.func
def read_witness_in_use(rows: wp.array(dtype=wp.float32), number: int):
    """Witness `number` of rows of four, of which this kernel may write a better one: the old or the new, whole."""
    return witness_in(read4(rows, number))
