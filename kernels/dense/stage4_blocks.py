"""Stage 4 of the dense query: the schedule of blocks, and the witness of each.

A cell is a block by itself, or where it has more than 8^3 voxels its eight bricks are, with one list. If a list is long
there are several, each with a split of it: then none is waited for. Of a cell of 8^3 voxels or more that is too coarse
for float32 the eight bricks are blocks with lists of their own. Blocks with long lists come first, so that those that
are left to the end, when some of the device has nothing to do, are short.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import BY_FACES, Tree, first_triangle, node_distance2, nodes_of, slots_of, tree_of
from sdm.kernels.culling.voronoi_features import Features
from sdm.kernels.culling.witness_bound import Witness, agree, moved, no_witness, read_witness, remember, write_witness
from sdm.kernels.dense.block_schedule import BlockSchedule, share_out
from sdm.kernels.dense.cell_cache import CachedBox, CellCache, cached_box, store_box
from sdm.kernels.dense.chunk_pool import CandidateLists, ChunkPool, list_length, read_entry, read_on, start_reading
from sdm.kernels.dense.counters import NEXT_CELL_TO_SCHEDULE
from sdm.kernels.dense.region_grid import BLOCK, RegionGrid, brick_number, brick_start, is_coarse, make_cell
from sdm.kernels.dense.stage1_witnesses import seen_from
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import BY_GRID, Slab, slab_of
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.vector_loads import load4

wp.set_module_options({"enable_backward": False})

# Thread blocks that a multiprocessor of a GPU holds: this kernel waits for memory more than it works.
SCHEDULE_BLOCKS_PER_SM = 8


@wp.func
def may_be_nearer(ball: wp.vec4, centre: wp.vec3, known: Witness):
    """True if a ball reaches nearer to a centre than what is known."""
    reach = wp.length(centre - wp.vec3(ball[0], ball[1], ball[2])) - ball[3]
    return reach <= 0.0 or reach * reach < known.distance2


@wp.func
def nearest_in_list(
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    features: Features,
    pool: ChunkPool,
    cells: CandidateLists,
    number: int,
    mesh: int,
    centre: wp.vec3,
    known: Witness,
    lane: int,
    lanes: int,
):
    """The surface point nearest to a centre, of the triangles in a cell's list or what was known."""
    boxes = nodes_of(tree, mesh) + (1 << tree.depth)
    mine = known
    reader = start_reading(cells, number * cells.shares, cells.shares)
    # Each batch is read while the one before is looked at.
    upcoming = read_entry(pool, reader, lane)
    while reader.left > 0:
        leaf = upcoming
        reader = read_on(pool, cells, reader, lanes)
        upcoming = read_entry(pool, reader, lane)
        if leaf >= 0 and node_distance2(tree, boxes + leaf, centre) < mine.distance2:
            for t in range(first_triangle(tree, leaf), first_triangle(tree, leaf + 1)):
                slot = slots_of(tree, mesh) + t
                if may_be_nearer(load4(features.balls, slot), centre, mine):
                    mine = remember(mine, seen_from(frames, slot, centre))
    return agree(mine, lane)


@wp.func
def nearest_of_cell(share_witnesses: wp.array(dtype=wp.float32), shares: int, number: int):
    """The nearest of the surface points that were found for a cell's centre."""
    known = no_witness()
    for share in range(shares):
        other = read_witness(share_witnesses, number * shares + share)
        if other.distance2 < known.distance2:
            known = other
    return known


@wp.func
def store_bricks(
    tree: Tree,
    slab: Slab,
    grid: RegionGrid,
    cache: CellCache,
    number: int,
    place: CachedBox,
    known: Witness,
    lane: int,
    lanes: int,
):
    """Store a witness of each of a cell's bricks, seen from its centre: the cell's. And the bricks' boxes."""
    o = lane
    while o < 8:
        first = brick_start(grid, place.start, o)
        brick = make_cell(tree, slab, place.mesh, first, grid.cell / 2)
        if grid.cell > BLOCK:
            store_box(cache, brick_number(grid, number, o), place.mesh, first, brick)
        if is_within(slab_of(slab, place.mesh), first):
            near = moved(known, brick.centre - place.box.centre)
            write_witness(cache.witnesses, grid.count + brick_number(grid, number, o), near)
        o = o + lanes


def _schedule_blocks_kernel(of_faces: Any, of_grid: Any) -> Any:
    @wp.kernel(launch_bounds=(128, SCHEDULE_BLOCKS_PER_SM))
    def _schedule_blocks(
        begin: int,
        lanes: int,
        split_length: int,
        given_tree: Tree,
        frames: wp.array(dtype=wp.float32),
        features: Features,
        given_slab: Slab,
        grid: RegionGrid,
        pool: ChunkPool,
        cells: CandidateLists,
        share_witnesses: wp.array(dtype=wp.float32),
        cache: CellCache,
        schedule: BlockSchedule,
    ):
        tree = of_faces(given_tree)
        slab = of_grid(given_slab)
        lane = (begin + wp.tid()) % lanes
        number = fetch_add_once(pool.counters, NEXT_CELL_TO_SCHEDULE, 1, lane)
        while number < 8 * grid.count:
            place = cached_box(cache, number)
            mesh = place.mesh
            cell = place.box
            one = tree_of(tree, mesh)
            if is_within(slab_of(slab, mesh), place.start):
                length = list_length(cells, number * cells.shares, cells.shares)
                known = no_witness()
                if length > 0:
                    known = nearest_of_cell(share_witnesses, cells.shares, number)
                by_bricks = grid.cell >= BLOCK and is_coarse(one, mesh, cell)
                if by_bricks:
                    store_bricks(one, slab, grid, cache, number, place, known, lane, lanes)
                else:
                    if length > 0:
                        known = nearest_in_list(
                            one, frames, features, pool, cells, number, mesh, cell.centre, known, lane, lanes
                        )
                    if lane == 0:
                        write_witness(cache.witnesses, grid.count + number, known)
                    if grid.cell > BLOCK:
                        store_bricks(one, slab, grid, cache, number, place, known, lane, lanes)
                if lane == 0:
                    share_out(schedule, not by_bricks, number, length, split_length)
            number = fetch_add_once(pool.counters, NEXT_CELL_TO_SCHEDULE, 1, lane)

    return _schedule_blocks


_SCHEDULE_BLOCKS = [_schedule_blocks_kernel(*own) for own in zip(BY_FACES, BY_GRID, strict=True)]


def schedule_blocks(
    tree: Tree,
    frames: wp.array,
    features: Features,
    slab: Slab,
    grid: RegionGrid,
    pool: ChunkPool,
    cells: CandidateLists,
    share_witnesses: wp.array,
    cache: CellCache,
    schedule: BlockSchedule,
    split_length: int,
    workers: int,
    lanes: int,
) -> None:
    """Write the schedule of one pass from the cells' lists, and the witnesses of blocks and boxes of bricks.

    One group of lanes takes up to `split_length` leaves of a cell's list. The cells' boxes are read from the cache, the
    surface points that were found for them from `share_witnesses`.
    """
    inputs = [lanes, split_length, tree, frames, features, slab, grid, pool, cells, share_witnesses, cache, schedule]
    alike = not (tree.meshes or slab.meshes)
    launch(_SCHEDULE_BLOCKS[alike], workers * lanes, inputs, frames.device, smallest=1)
