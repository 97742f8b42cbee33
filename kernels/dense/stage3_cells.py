"""Stage 3 of the dense query: candidate lists of cells, the leaves of the tree that matter to each.

One group of lanes takes one cell, or one share of its region's list. Triangles are not looked at here: where they are
many, each would be tested for every cell, and a leaf's box and cone tell nearly as much about its four.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import BY_FACES, Tree, node_box, nodes_of, tree_of
from sdm.kernels.culling.leaf_filter import box_matters
from sdm.kernels.culling.normal_cones import Cones
from sdm.kernels.culling.witness_bound import read_witness, write_witness
from sdm.kernels.dense.cell_cache import CellCache, cached_box
from sdm.kernels.dense.chunk_pool import (
    CandidateLists,
    Chain,
    ChunkPool,
    Reader,
    append,
    list_length,
    read_batch,
    start_reading,
)
from sdm.kernels.dense.counters import NEXT_CELL
from sdm.kernels.dense.region_grid import RegionGrid, own_shares
from sdm.kernels.dense.stage1_witnesses import nearer_of_leaves
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import BY_GRID, CELL_SHARES, REGION_SHARES, Slab, slab_of
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add_once

wp.set_module_options({"enable_backward": False})

# Thread blocks that a multiprocessor of a GPU holds: this kernel waits for memory more than it works.
CELL_BLOCKS_PER_SM = 6


def _list_cells_kernel(of_faces: Any, of_grid: Any) -> Any:
    @wp.kernel(launch_bounds=(128, CELL_BLOCKS_PER_SM))
    def _list_cells(
        begin: int,
        lanes: int,
        given_tree: Tree,
        frames: wp.array(dtype=wp.float32),
        cones: Cones,
        given_slab: Slab,
        grid: RegionGrid,
        cache: CellCache,
        pool: ChunkPool,
        regions: CandidateLists,
        cells: CandidateLists,
        share_witnesses: wp.array(dtype=wp.float32),
    ):
        tree = of_faces(given_tree)
        slab = of_grid(given_slab)
        lane = (begin + wp.tid()) % lanes
        item = fetch_add_once(pool.counters, NEXT_CELL, 1, lane)
        while item < 8 * grid.count * cells.shares:
            number = item / cells.shares
            place = cached_box(cache, number)
            # The chains of its region that are this share's; none beyond the mesh's own shares.
            share = item % cells.shares
            shares = own_shares(slab, place.mesh, CELL_SHARES, cells.shares)
            chains = own_shares(slab, place.mesh, REGION_SHARES, regions.shares) / shares
            first = (number / 8) * regions.shares + share * chains
            if share >= shares:
                chains = 0
            if is_within(slab_of(slab, place.mesh), place.start):
                mesh = place.mesh
                # Read again wherever it is needed, as registers are few.
                leaves = 1 << tree_of(tree, mesh).depth
                base = nodes_of(tree_of(tree, mesh), mesh)
                cell = place.box
                radius = wp.sqrt(cell.half2)
                known = read_witness(cache.witnesses, grid.count + number)
                chain = Chain()
                chain.chunk = pool.chunks
                head = grid.count * regions.shares + item
                reader = Reader()
                if list_length(regions, first, chains) >= 0:
                    reader = start_reading(regions, first, chains)
                    chain.chunk = head
                # Each batch is read while the one before is tested.
                upcoming, ahead, reader = read_batch(pool, regions, reader, lane, lanes)
                while ahead > 0 and chain.chunk < pool.chunks:
                    leaf = upcoming
                    upcoming, ahead, reader = read_batch(pool, regions, reader, lane, lanes)
                    # Read once, for both that follows.
                    low = wp.vec3()
                    high = wp.vec3()
                    if leaf >= 0:
                        low, high = node_box(tree, base + leaves + leaf)
                    one = tree_of(tree, mesh)
                    known = nearer_of_leaves(one, frames, mesh, leaf, low, high, cell.centre, known, lane)
                    keep = False
                    if leaf >= 0:
                        keep = box_matters(cell, radius, known, one, cones, base, leaves + leaf, low, high)
                    chain = append(pool, chain, keep, leaf, lane)
                if lane == 0:
                    write_witness(share_witnesses, item, known)
                    cells.heads[item] = wp.where(chain.chunk < pool.chunks, head, -1)
                    cells.lengths[item] = chain.length
            item = fetch_add_once(pool.counters, NEXT_CELL, 1, lane)

    return _list_cells


_LIST_CELLS = [_list_cells_kernel(*own) for own in zip(BY_FACES, BY_GRID, strict=True)]


def list_cells(
    tree: Tree,
    frames: wp.array,
    cones: Cones,
    slab: Slab,
    grid: RegionGrid,
    cache: CellCache,
    pool: ChunkPool,
    regions: CandidateLists,
    cells: CandidateLists,
    share_witnesses: wp.array,
    workers: int,
    lanes: int,
) -> None:
    """Write the cells' lists of one pass, into the pool, from their regions' lists and by the witnesses in the cache.

    And `share_witnesses` (8 * regions * shares * 4), the witness that each share of a cell's list leads to. `workers`
    groups of lanes are at work.
    """
    inputs = [lanes, tree, frames, cones, slab, grid, cache, pool, regions, cells, share_witnesses]
    alike = not (tree.meshes or slab.meshes)
    launch(_LIST_CELLS[alike], workers * lanes, inputs, frames.device, smallest=1)
