"""Winding numbers of a mesh with few boundary edges, by the edges alone: without caps or a tree.

The winding number is the crossings of the surface plus the boundary's share (`boundary_term`). A box of voxels gets the
share at its centre, by the sum over all edges, polynomials of the edges that are far for its size, and a list of those
that are near, which are added for each voxel (`strip_looks`). Boxes of twice the size come first: one to which few
edges are near takes an eighth of the looks at all edges. Voxels that are left in doubt get the sum over all edges
(`rim_voxels`; `doubtful_voxels` where there is no room for a list).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import Tree
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, GPU_LANES, gpu_workers
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.looks.count_places import (
    ALONE,
    BITS,
    COUNTS,
    EXACT,
    LENGTH,
    LOOKED,
    NEXT,
    NEXT_RECORD,
    RECORDED_NEAR,
    STRIDE,
    UNSURE,
)
from sdm.kernels.winding.looks.records import new_records
from sdm.kernels.winding.rims.doubtful_voxels import open_doubtful
from sdm.kernels.winding.rims.edges_once import edges_once
from sdm.kernels.winding.rims.rim_voxels import sum_rims
from sdm.kernels.winding.rims.strip_looks import SEERS, SETTLERS, see_strips, settle_strips

# A mesh with no more boundary edges than this, and for each from so many to that many faces, is opened by them: loose
# sheets and open boxes, whose caps are as large as they are, and so near for most boxes. Others are opened by caps.
MOST_EDGES = {"cuda": 2000, "cpu": 2000}
FACES_AN_EDGE = {"cuda": (0.5, 5), "cpu": (0.5, 6)}
# What an edge's polynomial may leave out of the solid angle, for as often as it counts.
TOLERANCES = {"cuda": 1e-2, "cpu": 6e-3}
# Voxels in doubt are listed, as long as there is room: for one of so many of a map, and for so many.
VOXELS_OF, LEAST_VOXELS = 32, 1 << 14
# Boxes that are recorded at a time, at most, and room for near edges of each, with those across.
MOST_RECORDS, NEAR_EACH = 1 << 18, 64
# Bits of the size of boxes, smaller ones where a GPU has less than so many for each group of lanes.
BOX_BITS = {"cuda": 3, "cpu": 2}
FEWEST = 4
# Larger ones come first if there are so many for each group of lanes, and are opened if so few edges are near.
FEWEST_LARGE, MOST_NEAR_LARGE = {"cuda": 1, "cpu": 0}, 8


def open_edges(
    tree: Tree, boundary: Boundary, caps: Caps, slab: Slab, values: wp.array, empty: Callable[[int, Any], wp.array]
) -> wp.array:
    """From the crossings of the surface to its winding numbers, where it matters for sign or clearness.

    Changes `values` (meshes, n, ny, nz) float32. `empty(length, dtype)` allocates workspace. Returns the
    counts, as `open_caps` has them.
    """
    device = values.device
    meshes, *shape = values.shape
    lanes, workers = 1, 16 * threads()
    if device.is_cuda:
        lanes, workers = GPU_LANES, gpu_workers(device, BLOCKS_PER_SM)
    seers, settlers = (gpu_workers(device, each) if device.is_cuda else workers for each in (SEERS, SETTLERS))
    kind = "cuda" if device.is_cuda else "cpu"
    counts = empty(COUNTS, wp.int32)
    counts.zero_()
    once, times = edges_once(boundary, meshes, empty)
    stacks = empty(1 if device.is_cuda else workers * LARGE_STACK_ON_CPU, wp.int32)
    bits = BOX_BITS[kind]
    if device.is_cuda and values.size >> (3 * bits) < FEWEST * workers:
        bits -= 1
    # Larger boxes first, if there is one for each group of lanes: of many few edges are near.
    parted = int(values.size >> (3 * bits + 3) >= FEWEST_LARGE[kind] * workers)
    level, total = BITS.index(bits), meshes * math.prod(-(-n >> bits) for n in shape)
    cells = wp.vec3i(0, 0, 0)
    # Boxes are recorded by so many at a time.
    records = new_records(min(MOST_RECORDS, total), NEAR_EACH * min(MOST_RECORDS, total), empty)
    left = boxes = (stacks, stacks)
    voxels = empty(values.size // VOXELS_OF + LEAST_VOXELS, wp.int32)
    for size in range(bits + parted, bits - 1, -1):
        boxes, left = left, (empty(total, wp.int32), empty(total, wp.int32))
        cells = wp.vec3i(*(-(-n >> size) for n in shape))
        number, halved = meshes * cells[0] * cells[1] * cells[2], int(size > bits)
        level = BITS.index(size)
        at, after = STRIDE * level, STRIDE * (level + 1)
        length = at + LENGTH if parted and not halved else -1
        part = [tree, once, times, slab, size]
        for first in range(0, number, MOST_RECORDS):
            if first > 0:
                counts[at + NEXT : at + NEXT + 1].zero_()
                counts[at + RECORDED_NEAR : at + STRIDE].zero_()
            some = [cells, boxes[0], length, first, min(first + MOST_RECORDS, number), records]
            most = MOST_NEAR_LARGE if halved else 1 << 30
            inputs = [*part, TOLERANCES[kind], most, *some, at + NEXT, at + RECORDED_NEAR, counts, stacks, lanes]
            launch(see_strips, seers * lanes, inputs, device, smallest=1)
            inputs = [*part, halved, *some, *left, voxels, at + NEXT_RECORD, at + LOOKED, after + LENGTH, UNSURE]
            inputs += [counts, lanes, values]
            launch(settle_strips, settlers * lanes, inputs, device, smallest=1)
    at, after = STRIDE * level, STRIDE * (level + 1)
    inputs = [tree, boundary, once, times, slab, workers, voxels, UNSURE, STRIDE * ALONE + LOOKED, EXACT]
    inputs += [counts, lanes, values]
    launch(sum_rims, workers * lanes, inputs, device, smallest=1)
    inputs = [tree, boundary, caps, 1, slab, bits, cells, workers if device.is_cuda else 0, *left]
    inputs += [after + LENGTH, after + NEXT, STRIDE * ALONE + LOOKED, EXACT, counts, lanes, values]
    launch(open_doubtful, workers * lanes, inputs, device, smallest=1)
    return counts
