"""Stage 3 of the dense query: candidate lists of cells, the leaves of the tree that matter to each.

One group of lanes takes one cell, or one share of its region's list. Triangles are not looked at here: where they are
many, each would be tested for every cell, and a leaf's box and cone tell nearly as much about its four.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, node_box, nodes_of
from sdm.kernels.culling.leaf_filter import box_matters
from sdm.kernels.culling.normal_cones import Cones
from sdm.kernels.culling.witness_bound import read_witness, write_witness
from sdm.kernels.dense.cell_cache import noted_place
from sdm.kernels.dense.stage1_witnesses import nearer_of_leaves
from sdm.kernels.dense.workspace import (
    NEXT_CELL,
    Chain,
    Lists,
    Reader,
    append,
    list_length,
    read_entry,
    read_on,
    start_reading,
)
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add_once

wp.set_module_options({"enable_backward": False})

# A multiprocessor of a GPU holds so many blocks: this kernel waits for memory more than it works.
CELL_BLOCKS = 6


@wp.kernel(launch_bounds=(128, CELL_BLOCKS))
def _list_cells(
    begin: int,
    lanes: int,
    tree: Tree,
    frames: wp.array(dtype=wp.float32),
    cones: Cones,
    slab: Slab,
    lists: Lists,
):
    lane = (begin + wp.tid()) % lanes
    leaves = 1 << tree.depth
    item = fetch_add_once(lists.counts, NEXT_CELL, 1, lane)
    while item < 8 * lists.count * lists.shares:
        number = item / lists.shares
        place = noted_place(lists, number)
        # The chains of its region that are this share's.
        chains = lists.region_shares / lists.shares
        first = (number / 8) * lists.region_shares + (item % lists.shares) * chains
        if is_within(slab, place.start):
            mesh = place.mesh
            base = nodes_of(tree, mesh)
            cell = place.box
            radius = wp.sqrt(cell.half2)
            known = read_witness(lists.witnesses, lists.count + number)
            chain = Chain()
            chain.chunk = lists.chunks
            head = lists.count * lists.region_shares + item
            reader = Reader()
            if list_length(lists.region_heads, lists.region_lengths, first, chains) >= 0:
                reader = start_reading(lists.region_heads, lists.region_lengths, first, chains)
                chain.chunk = head
            # Each batch is read while the one before is tested.
            upcoming = read_entry(lists, reader, lane)
            while reader.left > 0 and chain.chunk < lists.chunks:
                leaf = upcoming
                reader = read_on(lists, lists.region_heads, lists.region_lengths, reader, lanes)
                upcoming = read_entry(lists, reader, lane)
                # Read once, for both that follows.
                low = wp.vec3()
                high = wp.vec3()
                if leaf >= 0:
                    low, high = node_box(tree, base + leaves + leaf)
                known = nearer_of_leaves(tree, frames, mesh, leaf, low, high, cell.centre, known, lane)
                keep = False
                if leaf >= 0:
                    keep = box_matters(cell, radius, known, tree, cones, base, leaves + leaf, low, high)
                chain = append(lists, chain, keep, leaf, lane)
            if lane == 0:
                write_witness(lists.nearest, item, known)
                lists.heads[item] = wp.where(chain.chunk < lists.chunks, head, -1)
                lists.lengths[item] = chain.length
        item = fetch_add_once(lists.counts, NEXT_CELL, 1, lane)


def list_cells(
    tree: Tree,
    frames: wp.array,
    cones: Cones,
    slab: Slab,
    lists: Lists,
    workers: int,
    lanes: int,
) -> None:
    """Fill the cells' lists and `nearest` of one pass from their regions' lists, with `workers` groups of lanes."""
    launch(_list_cells, workers * lanes, [lanes, tree, frames, cones, slab, lists], frames.device, smallest=1)
