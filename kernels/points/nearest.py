"""The triangles nearest to scattered points: each packet's list, and of it the nearest to each of its points.

Which of a list's triangles is the nearest is decided as by `nearest_search.nearest_slot`: in float32, and in float64
among those that float32 cannot tell apart.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import exact_distance2
from sdm.kernels.bvh.tree import Tree, tree_of
from sdm.kernels.culling.normal_cones import Cones
from sdm.kernels.culling.witness_bound import LARGEST_SQUARE, read_witness
from sdm.kernels.launch import launch
from sdm.kernels.points.candidates import gather_near
from sdm.kernels.points.group_descent import SCRATCH, TIES
from sdm.kernels.points.lane_lists import keep_nearest
from sdm.kernels.points.packets import (
    NEXT_LIST,
    PACKET,
    POINT_BLOCKS_PER_SM,
    Packets,
    mesh_of,
    packet_end,
    point_or_middle,
    read_box,
)
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.lanes import wait_for_lanes

wp.set_module_options({"enable_backward": False})


@wp.func
def nearest_of_ties(
    tree: Tree, p: wp.vec3, scratch: wp.array(dtype=wp.int32), at: int, left: int, lane: int, lanes: int
):
    """The slot of the nearest to p (scaled) of the lane's `left` triangles, as float64 sees it; -1 without any."""
    first = at + TIES + lane
    nearest = int(-1)
    if left > 0:
        nearest = scratch[first]
    if left > 1:
        least2 = exact_distance2(tree, nearest >> 2, nearest & 3, p)
        for k in range(1, left):
            other = scratch[first + k * lanes]
            d2 = exact_distance2(tree, other >> 2, other & 3, p)
            wins = d2 < least2
            # Warp would load the faces of all, for what one line asks.
            if d2 == least2:
                wins = tree.face[other >> 2] < tree.face[nearest >> 2]
            if wins:
                least2 = d2
                nearest = other
    return nearest >> 2


@wp.kernel(launch_bounds=(128, POINT_BLOCKS_PER_SM))
def _find_nearest(
    begin: int,
    lanes: int,
    tree: Tree,
    balls: wp.array(dtype=wp.float32),
    cones: Cones,
    points: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    packets: Packets,
    scratch: wp.array(dtype=wp.int32),
    slots: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    room = (thread / lanes) * SCRATCH
    packet = fetch_add_once(packets.counts, NEXT_LIST, 1, lane)
    while packet < packets.count:
        box = read_box(packets, packet)
        known = read_witness(packets.witnesses, packet)
        found = int(0)
        if known.distance2 < LARGEST_SQUARE and box.half2 < LARGEST_SQUARE:
            one = tree_of(tree, mesh_of(packets, packet))
            found = gather_near(one, balls, cones, box, known, scratch, room, lane, lanes)
        end = packet_end(packets, packet)
        first = PACKET * packet
        while first < end:
            at = first + lane
            # All lanes work on each other's triangles, those without a point as if it were at the box's middle.
            p = wp.vec3(point_or_middle(tree, mesh_of(packets, packet), points, order, at, end, box))
            left = int(0)
            if found > 0:
                left = keep_nearest(tree, balls, p, scratch, room, found, lane, lanes)
            if at < end:
                slots[at] = nearest_of_ties(tree, p, scratch, room, left, lane, lanes)
            first = first + lanes
        # The scratch is read until here.
        wait_for_lanes()
        packet = fetch_add_once(packets.counts, NEXT_LIST, 1, lane)


def find_nearest(
    tree: Tree,
    balls: wp.array,
    cones: Cones,
    points: wp.array,
    order: wp.array,
    packets: Packets,
    scratch: wp.array,
    slots: wp.array,
    workers: int,
    lanes: int,
) -> None:
    """Fill `slots` (N,), in their order, with the triangle nearest to each of points (N,), or -1 for one to search for.

    `workers` groups of lanes are at work; `scratch` has room for workers * SCRATCH.
    """
    inputs = [lanes, tree, balls, cones, points, order, packets, scratch, slots]
    launch(_find_nearest, workers * lanes, inputs, points.device, smallest=1)
