"""The triangles nearest to scattered points: each group's list, and of it the nearest to each of its points.

Which of a list's triangles is the nearest is decided as by `closest.nearest_slot`: in float32, and in float64 among
those that float32 cannot tell apart.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.cones import Cones
from sdm.kernels.gather import SCRATCH, gather_near
from sdm.kernels.geometry import closest_point
from sdm.kernels.groups import GROUP, Groups, group_end, is_finite, numbered, read_box
from sdm.kernels.lanes import GPU_BLOCKS, fetch_add_once, wait_for_lanes
from sdm.kernels.shortlist import keep_nearest, own
from sdm.kernels.tree import SCALE, Tree
from sdm.kernels.voxels import LARGEST_SQUARE
from sdm.kernels.witness import read_witness

wp.set_module_options({"enable_backward": False})

_GROUP = wp.constant(GROUP)
_SCRATCH = wp.constant(SCRATCH)
_SCALE = wp.constant(SCALE)


@wp.func
def square_of(tree: Tree, slot: int, p: wp.vec3d):
    """Squared distance of p (scaled) from the triangle in a slot, in float64."""
    hit = closest_point(
        p,
        wp.vec3d(tree.corners[4 * slot]),
        wp.vec3d(tree.corners[4 * slot + 1]),
        wp.vec3d(tree.corners[4 * slot + 2]),
    )
    return hit.distance2


@wp.func
def nearest_of_own(
    tree: Tree, p: wp.vec3d, scratch: wp.array(dtype=wp.int32), at: int, left: int, lane: int, lanes: int
):
    """The nearest to p (scaled) of the lane's own `left` triangles, as float64 sees it; -1 if there are none."""
    nearest = int(-1)
    if left > 0:
        nearest = scratch[own(at, 0, lane, lanes)]
    if left > 1:
        least2 = square_of(tree, nearest, p)
        for k in range(1, left):
            slot = scratch[own(at, k, lane, lanes)]
            d2 = square_of(tree, slot, p)
            if d2 < least2:
                least2 = d2
                nearest = slot
    return nearest


@wp.kernel(launch_bounds=(128, GPU_BLOCKS))
def _find_nearest(
    begin: int,
    lanes: int,
    tree: Tree,
    balls: wp.array(dtype=wp.float32),
    cones: Cones,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    groups: Groups,
    next_group: wp.array(dtype=wp.int32),
    scratch: wp.array(dtype=wp.int32),
    slots: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    room = (thread / lanes) * _SCRATCH
    scale = tree.frame[_SCALE]
    group = fetch_add_once(next_group, 0, 1, lane)
    while group < groups.count:
        cell = read_box(groups, group)
        known = read_witness(groups.witnesses, group)
        found = int(0)
        if known.distance2 < LARGEST_SQUARE and cell.half2 < LARGEST_SQUARE:
            found = gather_near(tree, balls, cones, cell, known, scratch, room, lane, lanes)
        end = group_end(group, points.shape[0])
        first = _GROUP * group
        while first < end:
            at = first + lane
            # All lanes work on each other's triangles, those without a point as if it were at the box's middle.
            p = wp.vec3d(cell.centre)
            if at < end:
                point = points[numbered(order, at)]
                if is_finite(point):
                    p = scale * wp.vec3d(point)
            left = int(0)
            if found > 0:
                left = keep_nearest(tree, balls, wp.vec3(p), scratch, room, found, lane, lanes)
            if at < end:
                slots[at] = nearest_of_own(tree, p, scratch, room, left, lane, lanes)
            first = first + lanes
        # The scratch is read until here.
        wait_for_lanes()
        group = fetch_add_once(next_group, 0, 1, lane)


def find_nearest(
    tree: Tree,
    balls: wp.array,
    cones: Cones,
    points: wp.array,
    order: wp.array,
    groups: Groups,
    next_group: wp.array,
    scratch: wp.array,
    slots: wp.array,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Fill `slots` (N,), in their order, with the triangle nearest to each of points (N,), or -1 for one to search for.

    `workers` groups of lanes are at work; `next_group` (1,) must be zero; `scratch` has room for workers * SCRATCH.
    """
    inputs = [lanes, tree, balls, cones, points, order, groups, next_group, scratch, slots]
    launch(_find_nearest, workers * lanes, inputs, points.device, smallest=1)
