"""Test of whether a group of points is so far from an open mesh's holes that they do not decide about sides there.

Surface and caps (`sdm.kernels.winding.cap_tree`) together have a whole winding number, and the surface's own is that
number less the caps' share, which is their solid angle over 4 pi. Where the share is less than a quarter at every
point of a box, the whole number will do. Two bounds tell (`View`), for points within R of the box's centre:

- A triangle of area A at a distance d or more fills at most A/d^2; summed over all caps.
- As long as no cap is met, the share changes with the place by the boundary alone, for the caps' other edges cancel: an
  edge of length l at a distance d or more adds at most l/d^2 to the solid angle's gradient (the law of Biot and
  Savart). So the share is that at the centre, give or take R times the sum of l/(4 pi d^2).

The first is the sharper one from afar, the second near a cap, where it tells apart what sees a hole at an angle, and
may tell the side even where the share is large.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.geometry.triangle_distance import nearest_part, segment_distance2
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.primitives.lanes import ballot, sum_of_lanes
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.near_caps import near_cap

wp.set_module_options({"enable_backward": False})

# Less than a quarter, by more than the rounding of the sums.
LARGEST_SHARE = 0.249
# How much of a distance is left after rounding, which can take a thin triangle's plane for its edge.
SURE = 0.99
ROUNDING = 2.0e-6


@wp.struct
class View:
    """The two bounds of the caps' share for a box."""

    filled: float  # by areas and distances
    share: float  # at the centre
    error: float  # how far it may be from that anywhere in the box; infinite if a cap may be met


@wp.func
def view_caps(caps: Caps, boundary: Boundary, mesh: int, box: VoxelBox, lane: int, lanes: int):
    """All caps, seen from a box."""
    radius = wp.sqrt(box.half2)
    view = View()
    e = lane
    while e < boundary.count and wp.min(view.filled, view.error) < LARGEST_SHARE:
        # Edges and caps are in another order, but as many.
        edge = mesh * boundary.count + e
        begins = boundary.ends[2 * edge]
        ends = boundary.ends[2 * edge + 1]
        a = caps.tree.corners[4 * edge]
        b = caps.tree.corners[4 * edge + 1]
        c = caps.tree.corners[4 * edge + 2]
        across = wp.cross(b - a, c - a)
        area2 = wp.length(across)
        if area2 > 0.0:
            across = across / area2
        d2, _part = nearest_part(box.centre, a, b, c, across)
        gap = SURE * wp.sqrt(d2) - ROUNDING - radius
        rim = SURE * wp.sqrt(segment_distance2(box.centre - begins, ends - begins)) - ROUNDING - radius
        if gap > 0.0 and rim > 0.0:
            angle, error = near_cap(a - box.centre, b - box.centre, c - box.centre)
            view.filled = view.filled + area2 / (8.0 * wp.PI * gap * gap)
            view.share = view.share + angle / (4.0 * wp.PI)
            view.error = view.error + radius * wp.length(ends - begins) / (4.0 * wp.PI * rim * rim)
            view.error = view.error + error / (4.0 * wp.PI)
            e = e + lanes
        else:
            view.filled = float(wp.inf)
            view.error = float(wp.inf)
    if e < boundary.count:
        # Neither bound will do, and not all was seen.
        view.error = float(wp.inf)
    view.filled = sum_of_lanes(view.filled)
    view.error = sum_of_lanes(view.error)
    view.share = sum_of_lanes(view.share)
    return view


@wp.func
def is_far(view: View):
    """True if the caps' share of the winding number is less than a quarter at every point of a box."""
    return view.filled < LARGEST_SHARE or wp.abs(view.share) + view.error < LARGEST_SHARE


@wp.func
def may_cover(caps: Caps, mesh: int, box: VoxelBox, lane: int, lanes: int):
    """True if a line along x through a box may meet a cap: whether their shadows along x overlap, with some room."""
    meets = bool(False)
    count = caps.tree.count
    e = lane
    while e < count:
        slot = 4 * (mesh * count + e)
        a = caps.tree.corners[slot]
        b = caps.tree.corners[slot + 1]
        c = caps.tree.corners[slot + 2]
        low = wp.min(a, wp.min(b, c)) - box.centre - box.half
        high = wp.max(a, wp.max(b, c)) - box.centre + box.half
        room = ROUNDING * (1.0 + wp.abs(box.centre[1]) + wp.abs(box.centre[2]))
        meets = meets or (low[1] <= room and high[1] >= -room and low[2] <= room and high[2] >= -room)
        e = e + lanes
    return ballot(meets) != wp.uint32(0)
