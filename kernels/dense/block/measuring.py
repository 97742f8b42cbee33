"""Measurement of a block by one group of lanes, from its list of features.

It works the features out for the block's centre, one a lane, and finds the octants that each can be nearest to; then
one such pair a lane, and finds the eighths of the octant; then measures one feature in one eighth a lane. In the end
all voxels are written.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import Tree, load_corners
from sdm.kernels.culling.leaf_filter import push
from sdm.kernels.culling.voronoi_features import Features
from sdm.kernels.dense.block.feature_setup import (
    CORNER_KIND,
    EDGE_KIND,
    FeatureBatch,
    add_corner,
    add_edge,
    add_face,
    kind_of,
    next_batch,
    tests_of,
)
from sdm.kernels.dense.block.octant_tests import eighths_of, octants_of
from sdm.kernels.dense.block.octants_on_cpu import by_octants, measure_list
from sdm.kernels.dense.block.shared_layout import BATCH, ITEMS, MOST_ITEMS, PAIRS
from sdm.kernels.dense.block.voxels import NEAR_ENDS, Block, keep_block, kept_block, write_coordinates
from sdm.kernels.dense.block.winners import begin_block, end_block, measure_one, note_feature
from sdm.kernels.dense.chunk_pool import (
    CandidateLists,
    ChunkPool,
    Reader,
    list_length,
    read_entry,
    read_on,
    start_if_complete,
)
from sdm.kernels.geometry.voxel_grid import Output, Slab
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import on_cpu, wait_for_lanes
from sdm.kernels.primitives.work_queues import FEATURE_BITS, PAIR_BITS, enqueue, queue_entry

wp.set_module_options({"enable_backward": False})

# Where a worker's stacks begin: of faces, edges and corners that wait, at most 64 each.
FACES, EDGES, CORNERS = 0, 64, 128


@wp.func
def measure_features(
    scratch: wp.uint64,
    batch: FeatureBatch,
    octants: int,
    room: float,
    near: bool,
    turned: bool,
    winners: Any,
    lane: int,
    lanes: int,
):
    """Measure the lanes' features, whose rows are written, where they matter in the block's `octants` (bits) for each.

    Each step queues work for the next, so that all lanes have some.
    """
    pairs = int(0)
    items = int(0)
    # The next of the pairs; before all of them, the features themselves.
    first = int(-1)
    while first < pairs or items > 0:
        if first < pairs and items + 8 * lanes <= MOST_ITEMS:
            level = wp.where(first < 0, 0, 1)
            tag = int(lane)
            boxes = int(octants)
            if level == 1:
                boxes = int(0)
                if first + lane < pairs:
                    tag = queue_entry(scratch, PAIRS, first + lane)
                    boxes = eighths_of(scratch, tag, tests_of(kind_of(batch, tag & (BATCH - 1))))
            begin = wp.where(level == 0, PAIRS, ITEMS)
            bits = wp.where(level == 0, FEATURE_BITS, PAIR_BITS)
            total = enqueue(scratch, begin, items, tag, bits, boxes, lane)
            if level == 0:
                pairs = total
                first = int(0)
            else:
                items = total
                first = first + lanes
        else:
            taken = wp.min(lanes, items)
            items = items - taken
            if lane < taken:
                item = queue_entry(scratch, ITEMS, items + lane)
                measure_one(scratch, item, kind_of(batch, item & (BATCH - 1)), room, near, turned, taken, winners)
        wait_for_lanes()


@wp.func
def measure_block(
    tree: Tree,
    features: Features,
    slab: Slab,
    pool: ChunkPool,
    blocks: CandidateLists,
    first: int,
    scratch: wp.uint64,
    stack: wp.array(dtype=wp.int32),
    out: Output,
    block: Block,
    octants: int,
    parts: int,
    shares: int,
    winners: Any,
    lane: int,
    lanes: int,
):
    """Measure a block's `octants` (bits) from the features of its list; without one, every voxel is missed.

    They are one of so many `parts`, and the list is that of so many chains (`shares`) from `first` on.
    """
    # Each batch is read while the one before is worked out, the first one while coordinates are.
    reader = Reader()
    on_vectors = on_cpu() and slab.turned == 0 and by_octants(winners)
    if not on_vectors:
        reader = start_if_complete(blocks, first, shares)
    upcoming = read_entry(pool, reader, lane)
    write_coordinates(tree, slab, scratch, block, lane, lanes)
    begin_block(slab, out, scratch, block, octants, parts, winners, lane, lanes)
    keep_block(scratch, block, lane)
    wait_for_lanes()
    if on_vectors and list_length(blocks, first, shares) >= 0:
        room = NEAR_ENDS * (block.box.half[0] + block.box.half[1] + block.box.half[2])
        measure_list(tree, features, pool, blocks, first, shares, scratch, block, octants, room)
    corners = int(0)
    edges = int(0)
    faces = int(0)
    while reader.left + corners + edges + faces > 0:
        if reader.left > 0 and corners < lanes and edges < lanes and faces < lanes:
            feature = upcoming
            reader = read_on(pool, blocks, reader, lanes)
            upcoming = read_entry(pool, reader, lane)
            which = feature & 7
            code = 4 * (feature >> 3)
            corners = corners + push(stack, CORNERS + corners, feature >= 0 and which < 3, code + which, lane)
            is_edge = feature >= 0 and which >= 3 and which < 6
            edges = edges + push(stack, EDGES + edges, is_edge, code + which - 3, lane)
            faces = faces + push(stack, FACES + faces, feature >= 0 and which == 6, code, lane)
        else:
            batch = next_batch(corners, edges, faces, lanes)
            corners = corners - batch.corners
            edges = edges - batch.edges
            faces = faces - (batch.features - batch.corners - batch.edges)
            which = kind_of(batch, lane)
            there = int(0)
            code = int(0)
            if lane < batch.features:
                at = FACES + faces + lane - batch.corners - batch.edges
                if which == CORNER_KIND:
                    at = CORNERS + corners + lane
                elif which == EDGE_KIND:
                    at = EDGES + edges + lane - batch.corners
                code = stack[at]
            # Before the kinds part, which else wait for their loads one after the other.
            a, b, c, normal = load_corners(tree, code / 4)
            kept = kept_block(scratch)
            if lane < batch.features:
                if which == CORNER_KIND:
                    add_corner(scratch, lane, a, b, c, features, code, kept.box, kept.floor)
                elif which == EDGE_KIND:
                    add_edge(scratch, lane, a, b, c, normal, features, code, kept.box, kept.floor)
                else:
                    add_face(scratch, lane, a, b, c, normal, features, code, kept.box, kept.floor)
                note_feature(scratch, lane, which, code, winners)
                there = octants & octants_of(scratch, lane, tests_of(which))
            wait_for_lanes()
            room = NEAR_ENDS * (kept.box.half[0] + kept.box.half[1] + kept.box.half[2])
            measure_features(scratch, batch, there, room, kept.floor == 0.0, slab.turned != 0, winners, lane, lanes)
        wait_for_lanes()
    ended = kept_block(scratch)
    unclear = end_block(slab, out, scratch, ended, octants, parts, winners, lane, lanes)
    if unclear > 0:
        fetch_add(out.ambiguous, ended.mesh, unclear)
    wait_for_lanes()
