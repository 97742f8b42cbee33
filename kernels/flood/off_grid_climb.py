"""The way uphill between the voxels, for those from which no neighbour can be seen to be on the same side.

From the voxel it goes straight away from the closest point of the surface. Where two or more points are equally close,
in a corner, the direction is the shortest vector in the convex hull of the directions away from all of them, found
step by step (Frank and Wolfe 1956): where that is zero, nothing rises, and the distance has a maximum there (Lieutier,
Any open bounded subset of R^n has the same homotopy type as its medial axis, 2004). Every step is free: the balls about
both ends cover it. The climb ends at the first voxel in the ball about a point on the way that was reached, or is
further from the surface than the one where it began; without one, the voxel is inside.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.nearest_search import exact_hit, nearest_slot
from sdm.kernels.bvh.tree import SCALE, UNSCALE, Tree
from sdm.kernels.flood.flood_grid import FloodGrid, is_in_grid
from sdm.kernels.flood.flood_nodes import node_at, voxel_at
from sdm.kernels.flood.reached_region import REACHED
from sdm.kernels.flood.uphill_links import STUCK, StuckVoxels
from sdm.kernels.launch import launch, threads
from sdm.kernels.winding.ray_crossings import count_crossings

wp.set_module_options({"enable_backward": False})

# Threads of a GPU that share the list.
MOST_THREADS = 1 << 17
# Searches of one climb at most.
SEARCHES = 128
# The way ends where a step would be shorter than this share of the distance, or where it rises less than that.
SHORTEST = wp.constant(wp.float64(0.02))
FLATTEST = wp.constant(wp.float64(0.02))
# So near, in scaled coordinates, a voxel is on the surface itself, and has no direction: this is half a rounding.
ON_SURFACE = wp.constant(wp.float64(1.2e-7))
# Distances of points that are float32's are right to this share of the coordinates: they are measured in float64.
ROUNDING = wp.constant(wp.float64(1.0e-12))


@wp.struct
class Walls:
    """Surfaces that a climb goes away from: one mesh, and the triangles that close its small holes."""

    tree: Tree
    caps: Tree
    with_caps: wp.int32
    closed: wp.int32  # 1 if the mesh has no boundary


@wp.func
def _closest(tree: Tree, p: wp.vec3d, guess: int):
    """The closest point of a tree's triangles, in the mesh's unit, and the slot that it is in."""
    scaled = tree.frame[SCALE] * p
    slot = nearest_slot(tree, 0, wp.vec3(float(scaled[0]), float(scaled[1]), float(scaled[2])), guess)
    return tree.frame[UNSCALE] * exact_hit(tree, slot, scaled).point, slot


@wp.func
def _closest_of_both(walls: Walls, p: wp.vec3d, guesses: wp.vec2i):
    """The closest point of mesh and caps, and the slots of both, which are good guesses for a point nearby."""
    found, slot = _closest(walls.tree, p, guesses[0])
    cap = int(0)
    if walls.with_caps != 0:
        other, cap = _closest(walls.caps, p, guesses[1])
        if wp.length_sq(p - other) < wp.length_sq(p - found):
            found = other
    return found, wp.vec2i(slot, cap)


@wp.func
def _place(grid: FloodGrid, p: wp.vec3d):
    """The nearest voxel to a point."""
    away = p - grid.origin
    i = wp.vec3i(0, 0, 0)
    for axis in range(3):
        column = wp.vec3d(grid.axes[0, axis], grid.axes[1, axis], grid.axes[2, axis])
        i[axis] = int(wp.floor(wp.dot(column, away) / wp.dot(column, column) + wp.float64(0.5)))
    return i


@wp.func
def _rounded(p: wp.vec3d):
    """A point that float32 holds: the search is exact for those."""
    return wp.vec3d(wp.vec3(float(p[0]), float(p[1]), float(p[2])))


@wp.func
def _centre(grid: FloodGrid, i: int, j: int, k: int):
    """A voxel's centre, as it is measured: rounded to float32."""
    return _rounded(grid.origin + grid.axes * wp.vec3d(wp.float64(i), wp.float64(j), wp.float64(k)))


@wp.func
def _on_surface(walls: Walls, p: wp.vec3d, at: int):
    """The end of the climb of a voxel on the surface: its distance is zero, the sign that of the winding number."""
    end = REACHED
    if walls.closed != 0:
        if count_crossings(walls.tree, 0, walls.tree.frame[SCALE] * p) > 0:
            end = at
    return end


@wp.func
def climbed(
    walls: Walls,
    nodes: Any,
    grid: FloodGrid,
    distances: wp.array(dtype=wp.float32),
    links: wp.array(dtype=wp.int32),
    at: int,
):
    """The voxel where the climb from a voxel ends, itself if that is inside."""
    v = voxel_at(nodes, at)
    p = _centre(grid, v[0], v[1], v[2])
    closest, slots = _closest_of_both(walls, p, wp.vec2i(0, 0))
    away = p - closest
    distance = wp.length(away)
    scale = walls.tree.frame[SCALE]
    size = wp.max(wp.float64(1.0), scale * wp.max(wp.abs(p[0]), wp.max(wp.abs(p[1]), wp.abs(p[2]))))
    if scale * distance <= ON_SURFACE * size:
        return _on_surface(walls, p, at)
    least = wp.min(grid.spacing)
    most = wp.max(grid.spacing)
    step = wp.max(distance, wp.float64(0.5) * least)
    begun = wp.float64(distances[at])
    direction = away / distance
    count = int(SEARCHES)
    for _search in range(count):
        rise = wp.length(direction)
        if rise < FLATTEST or step < SHORTEST * distance:
            return at
        there = _rounded(p + (step / rise) * direction)
        closest, slots = _closest_of_both(walls, there, slots)
        found = wp.length(there - closest)
        if distance + found <= wp.length(there - p) + ROUNDING * size / scale:
            # Near the surface, in a dent, steps are about as long as the distance, however long a voxel is.
            step = wp.float64(0.5) * step
        elif found >= distance + wp.float64(0.5) * rise * step:
            p = there
            distance = found
            direction = (p - closest) / found
            step = wp.min(wp.float64(2.0) * step, wp.float64(2.0) * most)
            index = _place(grid, p)
            if is_in_grid(grid, index[0], index[1], index[2]):
                other = node_at(nodes, index)
                if wp.length(p - _centre(grid, index[0], index[1], index[2])) + grid.slack < distance:
                    if links[other] == REACHED or wp.float64(distances[other]) > begun + grid.slack:
                        return other
        else:
            # Another part of the surface is in the way.
            new = wp.normalize(p - closest)
            change = direction - new
            if wp.dot(direction, change) > wp.float64(0.1) * rise * rise:
                share = wp.min(wp.dot(direction, change) / wp.dot(change, change), wp.float64(1.0))
                direction = direction - share * change
            else:
                step = wp.float64(0.5) * step
    return at


@wp.kernel
def _climb_listed(
    begin: int,
    walls: Walls,
    grid: FloodGrid,
    distances: wp.array(dtype=wp.float32),
    links: wp.array(dtype=wp.int32),
    stuck: StuckVoxels,
    step: int,
):
    place = begin + wp.tid()
    count = wp.min(stuck.count[0], stuck.numbers.shape[0])
    while place < count:
        at = stuck.numbers[place]
        # Below zero, so that nobody takes the end of another climb for a voxel that was reached.
        links[at] = STUCK - 1 - climbed(walls, grid, grid, distances, links, at)
        place = place + step


@wp.kernel
def _climb_others(
    begin: int,
    walls: Walls,
    grid: FloodGrid,
    distances: wp.array(dtype=wp.float32),
    links: wp.array(dtype=wp.int32),
    stuck: StuckVoxels,
):
    """Those that there was no room for in the list, if there are any."""
    at = begin + wp.tid()
    if stuck.count[0] > stuck.numbers.shape[0]:
        if links[at] == STUCK:
            links[at] = STUCK - 1 - climbed(walls, grid, grid, distances, links, at)


@wp.func
def linked(links: wp.array(dtype=wp.int32), at: int):
    """The voxel that another one links to."""
    link = links[at]
    return wp.where(link < 0, STUCK - 1 - link, link)


def climb(walls: Walls, grid: FloodGrid, distances: wp.array, links: wp.array, stuck: StuckVoxels) -> None:
    """Find the links of the voxels that are `STUCK`; all are read by `linked` from then on."""
    device = links.device
    workers = min(stuck.numbers.shape[0], MOST_THREADS if device.is_cuda else 16 * threads())
    launch(_climb_listed, workers, [walls, grid, distances, links, stuck, workers], device, smallest=1)
    launch(_climb_others, links.shape[0], [walls, grid, distances, links, stuck], device)
