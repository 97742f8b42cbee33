"""Links uphill: from each voxel that the ball did not reach to one that is further from the surface, on the same side.

The neighbour with the steepest way there is taken, of those to which the segment is free: the balls of both ends cover
it, so it crosses no surface. Voxels without such a neighbour, near the surface most of them, climb between the voxels
(`off_grid_climb`). All links together are a forest: distances grow along each.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.flood.flood_grid import FloodGrid, is_free, is_in_grid, length_of
from sdm.kernels.flood.flood_nodes import neighbour_at, voxel_at
from sdm.kernels.flood.reached_region import REACHED
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add

wp.set_module_options({"enable_backward": False})

# Distances have to grow by this share of the way: what rises less is level, as rounding would decide.
LEVEL = wp.constant(wp.float64(1.0e-3))
# The link of a voxel that none of its neighbours takes.
STUCK = -1


@wp.struct
class StuckVoxels:
    """Numbers of the voxels that are stuck, in any order: those that there was room for."""

    numbers: wp.array(dtype=wp.int32)
    count: wp.array(dtype=wp.int32)  # (1) of all of them


@wp.func
def uphill(nodes: Any, grid: FloodGrid, distances: wp.array(dtype=wp.float32), at: int, here: wp.float64):
    """The neighbour with the steepest free way up from a voxel `here` away from the surface, or `STUCK`."""
    v = voxel_at(nodes, at)
    best = LEVEL
    link = STUCK
    # Bounds that are variables, so that Warp does not write the loop out.
    count = int(27)
    for place in range(count):
        di = place / 9 - 1
        dj = place / 3 % 3 - 1
        dk = place % 3 - 1
        if place != 13 and is_in_grid(grid, v[0] + di, v[1] + dj, v[2] + dk):
            other = neighbour_at(nodes, at, v, wp.vec3i(di, dj, dk))
            there = wp.float64(distances[other])
            length = length_of(grid, di, dj, dk)
            rise = (there - here) / length
            if rise > best and is_free(grid, here, there, length):
                best = rise
                link = other
    return link


@wp.func
def link_or_list(
    nodes: Any,
    grid: FloodGrid,
    distances: wp.array(dtype=wp.float32),
    links: wp.array(dtype=wp.int32),
    stuck: StuckVoxels,
    at: int,
):
    """Replace the label of a voxel by its link, and list it if it is stuck."""
    if links[at] == REACHED:
        return
    here = wp.float64(distances[at])
    if here >= grid.deep:
        # Whatever is uphill was not reached either: the ball passes along all links from here on.
        links[at] = at
        return
    link = uphill(nodes, grid, distances, at, here)
    links[at] = link
    if link == STUCK:
        place = fetch_add(stuck.count, 0, 1)
        if place < stuck.numbers.shape[0]:
            stuck.numbers[place] = at


@wp.kernel
def _link(
    begin: int,
    grid: FloodGrid,
    distances: wp.array(dtype=wp.float32),
    links: wp.array(dtype=wp.int32),
    stuck: StuckVoxels,
):
    link_or_list(grid, grid, distances, links, stuck, begin + wp.tid())


def link_uphill(grid: FloodGrid, distances: wp.array, links: wp.array, stuck: StuckVoxels) -> None:
    """Replace the labels of voxels that were not reached by links to other voxels; `STUCK` where there is none.

    Args:
        grid: The voxels.
        distances: (N,) float32, unsigned, to the surface and to what closes its small holes.
        links: (N,) int32, labels of `find_reached`; a voxel that links to itself is inside.
        stuck: Filled.
    """
    stuck.count.zero_()
    launch(_link, links.shape[0], [grid, distances, links, stuck], links.device)
