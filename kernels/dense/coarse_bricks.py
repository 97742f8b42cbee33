"""Voxels of bricks that are too coarse for float32, from their cells' lists: small grids have nothing else.

One lane takes one voxel, and all lanes of a group go through the same list: the triangles that float32 cannot tell
apart are judged in float64, as by `sdm.kernels.bvh.nearest_search`, whose answer this is. A search of the tree for each
voxel takes a GPU many times as long, as its lanes go different ways; a CPU has none, and searches its voxels one after
the other, each from the answer before.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.nearest_search import exact_distance2, exact_hit, moved_square, room_at, slot_part
from sdm.kernels.bvh.tree import (
    FRAME_SIZE,
    SCALE,
    UNSCALE,
    Tree,
    first_triangle,
    node_distance2,
    nodes_of,
    slots_of,
    tree_of,
)
from sdm.kernels.culling.witness_bound import read_witness
from sdm.kernels.dense.block_schedule import BlockSchedule, cell_of, split_of
from sdm.kernels.dense.cell_cache import CellCache, cached_box
from sdm.kernels.dense.chunk_pool import (
    CandidateLists,
    ChunkPool,
    list_length,
    read_entry,
    read_on,
    start_reading,
)
from sdm.kernels.dense.counters import COARSE
from sdm.kernels.dense.region_grid import RegionGrid, brick_start, is_coarse, make_cell
from sdm.kernels.dense.voxel_search import note_searched
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import (
    Output,
    Slab,
    distances_at,
    index_of,
    put_distance,
    read_distance,
    slab_of,
    voxel,
)
from sdm.kernels.launch import launch
from sdm.kernels.primitives.lanes import int_from_lane

wp.set_module_options({"enable_backward": False})


@wp.func
def nearest_of_list(
    tree: Tree,
    pool: ChunkPool,
    cells: CandidateLists,
    number: int,
    mesh: int,
    p: wp.vec3,
    within2: float,
    lane: int,
    lanes: int,
):
    """The slot of the triangle nearest to p (scaled) of those in a cell's list, or -1 if none is within a distance."""
    base = nodes_of(tree, mesh) + (1 << tree.depth)
    room = room_at(p)
    best = int(-1)
    best_part = int(0)
    out2 = within2 + 0.0
    better2 = within2 + 0.0
    exact2 = wp.float64(-1.0)
    reader = start_reading(cells, number * cells.shares, cells.shares)
    while reader.left > 0:
        mine = read_entry(pool, reader, lane)
        reader = read_on(pool, cells, reader, lanes)
        for k in range(lanes):
            leaf = int_from_lane(mine, k)
            if leaf >= 0 and node_distance2(tree, base + leaf, p) < out2:
                for t in range(first_triangle(tree, leaf), first_triangle(tree, leaf + 1)):
                    slot = slots_of(tree, mesh) + t
                    d2, part = slot_part(tree, slot, p)
                    if d2 < out2:
                        wins = best < 0 or d2 < better2
                        e2 = wp.float64(-1.0)
                        if not wins:
                            if exact2 < wp.float64(0.0):
                                exact2 = exact_distance2(tree, best, best_part, p)
                            e2 = exact_distance2(tree, slot, part, p)
                            wins = e2 < exact2
                            if e2 == exact2:
                                wins = tree.face[slot] < tree.face[best]
                        if wins:
                            best = slot
                            best_part = part
                            exact2 = e2
                            out2 = moved_square(d2, room)
                            better2 = moved_square(d2, -room)
    return best


@wp.kernel
def _search_bricks(
    begin: int,
    lanes: int,
    groups: int,
    tree: Tree,
    slab: Slab,
    grid: RegionGrid,
    pool: ChunkPool,
    cells: CandidateLists,
    cache: CellCache,
    schedule: BlockSchedule,
    out: Output,
):
    if out.missed[0] == 0:
        return
    thread = begin + wp.tid()
    lane = thread % lanes
    item = thread / lanes
    size = grid.cell / 2
    turns = size * size * size / lanes
    address = distances_at(out)
    while item < 8 * schedule.counters[COARSE] * turns:
        brick = item / turns
        code = schedule.coarse[brick / 8]
        number = cell_of(code)
        place = cached_box(cache, number)
        mesh = place.mesh
        one = tree_of(tree, mesh)
        here = slab_of(slab, mesh)
        start = brick_start(grid, place.start, brick % 8)
        length = list_length(cells, number * cells.shares, cells.shares)
        # Each split of a list has the whole of it.
        if split_of(code) == 0 and length > 0 and is_within(here, start):
            if is_coarse(make_cell(one, here, mesh, start, size)):
                inner = (item % turns) * lanes + lane
                at = start + wp.vec3i(inner / (size * size), (inner / size) % size, inner % size)
                scale = tree.frame[mesh * FRAME_SIZE + SCALE]
                point = voxel(here, at[0], at[1], at[2])
                p = float(scale) * point
                known = read_witness(cache.witnesses, grid.count + number)
                away = p - (place.box.centre - known.to_surface)
                within2 = float(wp.inf)
                if known.distance2 < float(wp.inf):
                    within2 = moved_square(wp.dot(away, away), 2.0 * room_at(p))
                best = nearest_of_list(one, pool, cells, number, mesh, p, within2, lane, lanes)
                if best >= 0 and is_within(here, at):
                    index = index_of(here, mesh, at)
                    before = read_distance(address, index)
                    if before == wp.inf or before == -wp.inf:
                        hit = exact_hit(one, best, scale * wp.vec3d(point))
                        distance = float(wp.sqrt(hit.distance2) * tree.frame[mesh * FRAME_SIZE + UNSCALE])
                        put_distance(address, index, wp.where(before < 0.0, -distance, distance))
                        note_searched(out, index, best)
        item = item + groups


def search_bricks(
    tree: Tree,
    slab: Slab,
    grid: RegionGrid,
    pool: ChunkPool,
    cells: CandidateLists,
    cache: CellCache,
    schedule: BlockSchedule,
    out: Output,
    groups: int,
    lanes: int,
) -> None:
    """Put distances where they are infinite in bricks of the pass that are too coarse to be measured.

    `tree` is the one that the lists are of, and `groups` groups of lanes are at work. A voxel without an answer stays
    as it is, for `voxel_search.mend_slab`.
    """
    inputs = [lanes, groups, tree, slab, grid, pool, cells, cache, schedule, out]
    launch(_search_bricks, groups * lanes, inputs, out.values.device, smallest=1)
