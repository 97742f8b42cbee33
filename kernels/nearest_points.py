"""Distances of scattered points: each group's list of triangles, and of these the nearest to each of its points.

A group without a list (too long, or without a box) is searched point by point. Either way float64 finishes.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.closest import begin_with, consider, nearest_slot, room_at
from sdm.kernels.cones import Cones
from sdm.kernels.gather import SCRATCH, gather_near
from sdm.kernels.geometry import closest_point
from sdm.kernels.groups import GROUP, Groups, group_end, is_finite, numbered, read_box, read_group_witness
from sdm.kernels.lanes import GPU_BLOCKS, fetch_add_once, wait_for_lanes
from sdm.kernels.shortlist import keep_near
from sdm.kernels.tree import SCALE, UNSCALE, Tree
from sdm.kernels.voxels import LARGEST_SQUARE

wp.set_module_options({"enable_backward": False})

_GROUP = wp.constant(GROUP)
_SCRATCH = wp.constant(SCRATCH)
_SCALE, _UNSCALE = wp.constant(SCALE), wp.constant(UNSCALE)


@wp.struct
class Hits:
    """Where the closest points are, if `wanted`."""

    points: wp.array(dtype=wp.vec3)
    faces: wp.array(dtype=wp.int32)  # -1 for a point that is not finite
    barycentric: wp.array(dtype=wp.vec3)
    wanted: wp.int32


@wp.func
def nearest_in_list(
    tree: Tree,
    balls: wp.array(dtype=wp.float32),
    p: wp.vec3,
    guess: int,
    scratch: wp.array(dtype=wp.int32),
    room: int,
    found: int,
    lane: int,
    lanes: int,
):
    """The slot of the triangle nearest to the lane's p (scaled), of a guess and those found for its group."""
    rounding = room_at(p)
    column = keep_near(balls, p, rounding, scratch, room, found, lane, lanes)
    best = begin_with(tree, guess, p, rounding)
    for k in range(column.count):
        best = consider(tree, best, scratch[column.begin + k * column.step], p, rounding)
    return best.slot


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
    lists: int,
    scratch: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
    hits: Hits,
):
    thread = begin + wp.tid()
    lane = thread % lanes
    room = (thread / lanes) * _SCRATCH
    scale = tree.frame[_SCALE]
    unscale = tree.frame[_UNSCALE]
    group = fetch_add_once(next_group, 0, 1, lane)
    while group < groups.count:
        cell = read_box(groups, group)
        known = read_group_witness(groups, group)
        slot = groups.nearest[group]
        found = int(-1)
        if lists != 0 and known.distance2 < LARGEST_SQUARE and cell.half2 < LARGEST_SQUARE:
            found = gather_near(tree, balls, cones, cell, known, scratch, room, lane, lanes)
        end = group_end(group, points.shape[0])
        first = _GROUP * group
        while first < end:
            at = first + lane
            i = int(0)
            point = wp.vec3(wp.nan, wp.nan, wp.nan)
            if at < end:
                i = numbered(order, at)
                point = points[i]
            usable = is_finite(point)
            nearest = slot
            if found >= 0:
                # All lanes work on each other's lists, those without a point of their own as if at the box's middle.
                p = cell.centre
                if usable:
                    p = float(scale) * point
                nearest = nearest_in_list(tree, balls, p, slot, scratch, room, found, lane, lanes)
            elif usable:
                nearest = nearest_slot(tree, 0, float(scale) * point, slot)
                slot = nearest
            if usable:
                hit = closest_point(
                    scale * wp.vec3d(point),
                    wp.vec3d(tree.corners[4 * nearest]),
                    wp.vec3d(tree.corners[4 * nearest + 1]),
                    wp.vec3d(tree.corners[4 * nearest + 2]),
                )
                values[i] = float(wp.sqrt(hit.distance2) * unscale)
                if hits.wanted != 0:
                    hits.points[i] = wp.vec3(unscale * hit.point)
                    hits.faces[i] = tree.face[nearest]
                    hits.barycentric[i] = wp.vec3(hit.barycentric)
            elif at < end:
                values[i] = float(wp.nan)
                if hits.wanted != 0:
                    hits.points[i] = wp.vec3(wp.nan, wp.nan, wp.nan)
                    hits.faces[i] = -1
                    hits.barycentric[i] = wp.vec3(wp.nan, wp.nan, wp.nan)
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
    lists: bool,
    scratch: wp.array,
    values: wp.array,
    hits: Hits,
    workers: int,
    lanes: int,
    launch: Any,
) -> None:
    """Fill `values` (N,) with distances of points (N,), and `hits`, `workers` groups of lanes at work.

    `next_group` (1,) must be zero. Without `lists` each point is searched by itself. `scratch` has room for
    workers * SCRATCH.
    """
    inputs = [lanes, tree, balls, cones, points, order, groups, next_group, int(lists), scratch, values, hits]
    launch(_find_nearest, workers * lanes, inputs, points.device, smallest=1)
