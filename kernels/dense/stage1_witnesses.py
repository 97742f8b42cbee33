"""Stage 1 of the dense query: witnesses, surface points near the centres of regions and cells, which all else is
compared with (see `witness_bound`).

The lanes of a group look at all of the surface for a region: from one of the tree's nodes of a level each goes down,
always to the child that is nearer to the centre, and measures the triangles that it comes to. A cell takes what its
region found, or what is found from the root for its own centre.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, box_distance2, first_triangle, node_distance2, nodes_of, slots_of, tree_of
from sdm.kernels.bvh.triangle_frames import load_frame, see
from sdm.kernels.culling.witness_bound import Witness, agree, away, moved, no_witness, remember, write_witness
from sdm.kernels.dense.cell_cache import CellCache, store_box
from sdm.kernels.dense.counters import NEXT_WITNESS
from sdm.kernels.dense.region_grid import RegionGrid, cell_start, make_cell, region_start
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import Slab, slab_of
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.lanes import ballot, members

wp.set_module_options({"enable_backward": False})

# Nodes from which to look.
PROBES = 32


@wp.func
def greedy_leaf(tree: Tree, mesh: int, first: int, p: wp.vec3):
    """A leaf near p below the node `first`: always the nearer child."""
    base = nodes_of(tree, mesh)
    node = int(first)
    while node < 1 << tree.depth:
        left = base + 2 * node
        left2 = node_distance2(tree, left, p)
        right2 = node_distance2(tree, left + 1, p)
        node = 2 * node + wp.where(right2 < left2, 1, 0)
    return node - (1 << tree.depth)


@wp.func
def seen_from(frames: wp.array(dtype=wp.float32), slot: int, centre: wp.vec3):
    """The vector from a triangle's closest point to a centre."""
    f = load_frame(frames, slot)
    return away(f, see(f, centre))


@wp.func
def nearer_leaf(tree: Tree, frames: wp.array(dtype=wp.float32), mesh: int, first: int, centre: wp.vec3, known: Witness):
    """Witness of a centre: the one known, or a nearer triangle from a leaf near it below the node `first`."""
    leaf = greedy_leaf(tree, mesh, first, centre)
    for t in range(first_triangle(tree, leaf), first_triangle(tree, leaf + 1)):
        known = remember(known, seen_from(frames, slots_of(tree, mesh) + t, centre))
    return known


@wp.func
def nearer_of_leaves(
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    mesh: int,
    leaf: int,
    low: wp.vec3,
    high: wp.vec3,
    centre: wp.vec3,
    known: Witness,
    lane: int,
):
    """Witness of a centre: the one known, or a nearer triangle of the lanes' leaves (-1 for none) with these boxes.

    Only the first triangle of a leaf is looked at, and only if its box is nearer than what is known: few are.
    """
    nearer = leaf >= 0 and box_distance2(centre, low, high) < known.distance2
    if members(ballot(nearer)) == 0:
        return known
    mine = known
    if nearer and first_triangle(tree, leaf) < first_triangle(tree, leaf + 1):
        mine = remember(mine, seen_from(frames, slots_of(tree, mesh) + first_triangle(tree, leaf), centre))
    return agree(mine, lane)


@wp.func
def region_witness(tree: Tree, frames: wp.array(dtype=wp.float32), mesh: int, centre: wp.vec3, lane: int, lanes: int):
    """Witness of a region's centre, by all lanes of a group."""
    known = no_witness()
    probes = wp.min(PROBES, 1 << tree.depth)
    probe = int(lane)
    while probe < probes:
        known = nearer_leaf(tree, frames, mesh, probes + probe, centre, known)
        probe = probe + lanes
    return agree(known, lane)


@wp.func
def cell_witness(
    tree: Tree, frames: wp.array(dtype=wp.float32), mesh: int, cell: wp.vec3, region: wp.vec3, known: Witness
):
    """Witness of a cell's centre: that of its region's centre, or a nearer one."""
    return nearer_leaf(tree, frames, mesh, 1, cell, moved(known, cell - region))


# A multiprocessor of a GPU holds so many blocks: this kernel waits for memory more than it works.
WITNESS_BLOCKS = 8


@wp.kernel(launch_bounds=(128, WITNESS_BLOCKS))
def _find_witnesses(
    begin: int,
    lanes: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    slab: Slab,
    grid: RegionGrid,
    counters: wp.array(dtype=wp.int32),
    cache: CellCache,
):
    lane = (begin + wp.tid()) % lanes
    item = fetch_add_once(counters, NEXT_WITNESS, 1, lane)
    while item < grid.count:
        mesh, start = region_start(slab, grid, item)
        one = tree_of(tree, mesh)
        region = make_cell(one, slab, mesh, start, 2 * grid.cell)
        known = region_witness(one, frames, mesh, region.centre, lane, lanes)
        if lane == 0:
            write_witness(cache.witnesses, item, known)
        # Each cell begins with its region's, and one lane looks for a nearer one.
        octant = lane
        while octant < 8:
            number = 8 * item + octant
            first = cell_start(grid, start, octant)
            cell = make_cell(one, slab, mesh, first, grid.cell)
            store_box(cache, number, mesh, first, cell)
            if is_within(slab_of(slab, mesh), first):
                mine = cell_witness(one, frames, mesh, cell.centre, region.centre, known)
                write_witness(cache.witnesses, grid.count + number, mine)
            octant = octant + lanes
        item = fetch_add_once(counters, NEXT_WITNESS, 1, lane)


def find_witnesses(
    tree: Tree,
    frames: wp.array,
    slab: Slab,
    grid: RegionGrid,
    counters: wp.array,
    cache: CellCache,
    workers: int,
    lanes: int,
) -> None:
    """Write the cache of one pass: witnesses of its regions and cells, and the boxes of its cells.

    `workers` groups of lanes are at work.
    """
    inputs = [lanes, tree, frames, slab, grid, counters, cache]
    launch(_find_witnesses, workers * lanes, inputs, frames.device, smallest=1)
