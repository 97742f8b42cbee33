"""Stage 1 of the dense query for regions in a list: witnesses of those that have voxels of a band, and their cells."""

from __future__ import annotations

import warp as wp

from sdm.kernels.band.block_bits import REGIONS
from sdm.kernels.bvh.tree import Tree
from sdm.kernels.culling.witness_bound import Witness, write_witness
from sdm.kernels.dense.cell_cache import LEFT_OUT, CellCache, store_box
from sdm.kernels.dense.counters import NEXT_WITNESS
from sdm.kernels.dense.region_grid import RegionGrid, cell_start, make_cell
from sdm.kernels.dense.stage1_witnesses import WITNESS_BLOCKS, cell_witness, region_witness
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add_once

wp.set_module_options({"enable_backward": False})


@wp.kernel(launch_bounds=(128, WITNESS_BLOCKS))
def _find_listed_witnesses(
    begin: int,
    lanes: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    slab: Slab,
    grid: RegionGrid,
    regions: wp.array(dtype=wp.vec4i),
    listed: wp.array(dtype=wp.int32),
    counters: wp.array(dtype=wp.int32),
    cache: CellCache,
):
    lane = (begin + wp.tid()) % lanes
    item = fetch_add_once(counters, NEXT_WITNESS, 1, lane)
    while item < grid.count:
        place = grid.first + item * grid.step
        there = place < listed[REGIONS]
        asked = wp.vec4i()
        if there:
            asked = regions[place]
        start = 2 * grid.cell * wp.vec3i(asked[0], asked[1], asked[2])
        region = make_cell(tree, slab, 0, start, 2 * grid.cell)
        known = Witness()
        if there:
            known = region_witness(tree, frames, 0, region.centre, lane, lanes)
            if lane == 0:
                write_witness(cache.witnesses, item, known)
        octant = lane
        while octant < 8:
            number = 8 * item + octant
            first = cell_start(grid, start, octant)
            wanted = ((asked[3] >> octant) & 1) != 0 and is_within(slab, first)
            if wanted:
                cell = make_cell(tree, slab, 0, first, grid.cell)
                store_box(cache, number, 0, first, cell)
                mine = cell_witness(tree, frames, 0, cell.centre, region.centre, known)
                write_witness(cache.witnesses, grid.count + number, mine)
            else:
                # Beyond the slab, for all that comes later; and where there is room alone, so is the region.
                store_box(cache, number, 0, first + wp.vec3i(LEFT_OUT, wp.where(there, 0, LEFT_OUT), 0), region)
            octant = octant + lanes
        item = fetch_add_once(counters, NEXT_WITNESS, 1, lane)


def find_listed_witnesses(
    regions: wp.array,
    listed: wp.array,
    tree: Tree,
    frames: wp.array,
    slab: Slab,
    grid: RegionGrid,
    counters: wp.array,
    cache: CellCache,
    workers: int,
    lanes: int,
) -> None:
    """Write the cache of one pass over listed regions of one mesh's slab; see `stage1_witnesses.find_witnesses`.

    `regions` (R,) vec4i: each one's place among all, and a bit for each of its eight cells that is wanted.
    `listed`, see `block_bits`, has how many there are as its number `REGIONS`: if they are less, the rest is room.
    """
    inputs = [lanes, tree, frames, slab, grid, regions, listed, counters, cache]
    launch(_find_listed_witnesses, workers * lanes, inputs, frames.device, smallest=1)
