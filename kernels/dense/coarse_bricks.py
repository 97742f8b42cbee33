"""Voxels of bricks that are too coarse for float32, from their cells' lists: small grids have nothing else.

A few lanes take one voxel and share out its cell's list: the triangles that float32 cannot tell apart are judged in
float64, as by `sdm.kernels.bvh.nearest_search`, whose answer this is, whatever the order. A search of the tree for each
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
from sdm.kernels.dense.region_grid import BLOCK, RegionGrid, brick_start, is_coarse, make_cell
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
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, double_from_lane, int_from_lane, least_of_some

wp.set_module_options({"enable_backward": False})

# Lanes of a GPU's group for each voxel, and thread blocks of a multiprocessor.
LANES_EACH, SEARCH_BLOCKS_PER_SM = 8, 2 * BLOCKS_PER_SM


@wp.struct
class Nearest:
    """The nearest triangle of those that a lane has looked at."""

    slot: wp.int32  # -1 if none is near enough
    part: wp.int32
    out2: wp.float32  # what is further than this is out
    better2: wp.float32  # what is nearer than this is better; float64 judges what lies between
    exact2: wp.float64  # its squared distance in float64, once that was needed, else -1


@wp.func
def look_into_leaf(tree: Tree, mesh: int, leaf: int, p: wp.vec3, room: float, found: Nearest):
    """The nearest of the triangles of a leaf and the one found before; of equally near ones that of the least face."""
    for t in range(first_triangle(tree, leaf), first_triangle(tree, leaf + 1)):
        slot = slots_of(tree, mesh) + t
        d2, part = slot_part(tree, slot, p)
        if d2 < found.out2:
            wins = found.slot < 0 or d2 < found.better2
            e2 = wp.float64(-1.0)
            if not wins:
                if found.exact2 < wp.float64(0.0):
                    found.exact2 = exact_distance2(tree, found.slot, found.part, p)
                e2 = exact_distance2(tree, slot, part, p)
                wins = e2 < found.exact2
                if e2 == found.exact2:
                    wins = tree.face[slot] < tree.face[found.slot]
            if wins:
                found.slot = slot
                found.part = part
                found.exact2 = e2
                found.out2 = wp.min(found.out2, moved_square(d2, room))
                found.better2 = moved_square(d2, -room)
    return found


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
    each: int,
):
    """The slot of the triangle nearest to p (scaled) of those in a cell's list, or -1 if none is within a distance.

    `each` neighbouring lanes have the same p, and share out the list. Each looks first into that leaf of its own whose
    box is nearest: after that hardly any other is near enough.
    """
    base = nodes_of(tree, mesh) + (1 << tree.depth)
    room = room_at(p)
    mine = lane % each
    first = int(-1)
    first2 = within2 + 0.0
    reader = start_reading(cells, number * cells.shares, cells.shares)
    while reader.left > 0:
        entry = read_entry(pool, reader, lane)
        reader = read_on(pool, cells, reader, lanes)
        for k in range(lanes / each):
            leaf = int_from_lane(entry, k * each + mine)
            if leaf >= 0:
                box2 = node_distance2(tree, base + leaf, p)
                if box2 < first2:
                    first = leaf
                    first2 = box2
    found = Nearest()
    found.slot = -1
    found.out2 = within2
    found.better2 = within2
    found.exact2 = wp.float64(-1.0)
    if first >= 0:
        found = look_into_leaf(tree, mesh, first, p, room, found)
    reader = start_reading(cells, number * cells.shares, cells.shares)
    while reader.left > 0:
        found.out2 = least_of_some(found.out2, each)
        entry = read_entry(pool, reader, lane)
        reader = read_on(pool, cells, reader, lanes)
        for k in range(lanes / each):
            leaf = int_from_lane(entry, k * each + mine)
            if leaf >= 0 and leaf != first:
                if node_distance2(tree, base + leaf, p) < found.out2:
                    found = look_into_leaf(tree, mesh, leaf, p, room, found)
    # All lanes' distances from one line of code, as another may be rounded otherwise.
    best = found.slot
    exact2 = wp.float64(wp.inf)
    if best >= 0 and each > 1:
        exact2 = exact_distance2(tree, best, found.part, p)
    step = each / 2
    while step > 0:
        other = int_from_lane(best, lane ^ step)
        other2 = double_from_lane(exact2, lane ^ step)
        if other >= 0:
            wins = best < 0 or other2 < exact2
            if best >= 0 and other2 == exact2:
                wins = tree.face[other] < tree.face[best]
            if wins:
                best = other
                exact2 = other2
        step = step / 2
    return best


@wp.kernel
def _search_bricks(
    begin: int,
    lanes: int,
    each: int,
    groups: int,
    below: int,
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
    # Cells of 4^3 voxels have no bricks.
    whole = grid.cell < BLOCK
    size = wp.where(whole, grid.cell, grid.cell / 2)
    together = lanes / each
    turns = size * size * size / together
    address = distances_at(out)
    while item < 8 * wp.where(whole, grid.count, schedule.counters[COARSE]) * turns:
        brick = item / turns
        code = int(brick)
        if not whole:
            code = schedule.coarse[brick / 8]
        number = cell_of(code)
        place = cached_box(cache, number)
        mesh = place.mesh
        one = tree_of(tree, mesh)
        here = slab_of(slab, mesh)
        start = place.start
        if not whole:
            start = brick_start(grid, place.start, brick % 8)
        length = list_length(cells, number * cells.shares, cells.shares)
        # Each split of a list has the whole of it. Maps of a list that are longer are searched by the tree, as alone.
        wanted = (whole or split_of(code) == 0) and wp.max(here.shape) < below
        if wanted and length > 0 and is_within(here, start):
            if is_coarse(one, mesh, make_cell(one, here, mesh, start, size)):
                inner = (item % turns) * together + lane / each
                at = start + wp.vec3i(inner / (size * size), (inner / size) % size, inner % size)
                scale = tree.frame[mesh * FRAME_SIZE + SCALE]
                point = voxel(here, at[0], at[1], at[2])
                p = float(scale) * point
                known = read_witness(cache.witnesses, grid.count + number)
                away = p - (place.box.centre - known.to_surface)
                within2 = float(wp.inf)
                if known.distance2 < float(wp.inf):
                    within2 = moved_square(wp.dot(away, away), 2.0 * room_at(p))
                best = nearest_of_list(one, pool, cells, number, mesh, p, within2, lane, lanes, each)
                if best >= 0 and lane % each == 0 and is_within(here, at):
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
    below: int,
    groups: int,
    lanes: int,
) -> None:
    """Put distances where they are infinite in bricks of the pass that are too coarse to be measured.

    `tree` is the one that the lists are of, and `groups` groups of lanes are at work. A voxel without an answer stays
    as it is, for `voxel_search.mend_slab`, and so do all of a map with `below` voxels or more along some axis.
    """
    each = LANES_EACH if out.values.device.is_cuda else 1
    inputs = [lanes, each, groups, below, tree, slab, grid, pool, cells, cache, schedule, out]
    launch(_search_bricks, groups * lanes, inputs, out.values.device, smallest=1)
