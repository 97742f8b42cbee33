"""Opening of an open mesh's caps: from the whole winding numbers of surface and caps to the surface's own.

What has to be right is on which side of 0.25, 0.5 and 0.75 the winding number of a voxel is: that is sign and
clearness. Boxes of 32^3 voxels are looked at first (`sdm.kernels.winding.cap_field`). Where the caps' share is less
than a quarter all over a box, its whole numbers will do; where the field's error leaves no voxel in doubt, the field's
values are taken; else its octants are looked at, down to 4^3 voxels: each octant from what the tree's descent for the
whole box has found (`sdm.kernels.winding.cap_descent`). What the last leave in doubt is looked at again, with smaller
tolerances (`looks.look_again`). What is in doubt even so gets the sum over all caps in float32 (`rims.single_voxels`),
and what is still, that over all boundary edges in float64 (`rims.exact_voxels`; where boxes are listed
`rims.doubtful_voxels` does both), as `boundary_term` has it: so every voxel is on the side where that is.

That is the way of a GPU. A CPU has one of its own from boxes of 4^3 on (`eights.boxes_by_caps`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import Tree
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.launch import launch, new_zeros, threads
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, GPU_LANES, gpu_workers
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.cap_descent import MOST_NEAR
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.looks.count_places import (
    ALONE,
    BITS,
    COUNTS,
    EXACT,
    LENGTH,
    LOOKED,
    NEXT,
    NEXT_EXACT,
    NEXT_RECORD,
    NEXT_UNSURE,
    RECORDED,
    RECORDED_NEAR,
    STRIDE,
    UNSURE,
)
from sdm.kernels.winding.looks.count_places import AROUND as BOXES_AROUND
from sdm.kernels.winding.looks.look_again import LOOK_AGAIN
from sdm.kernels.winding.looks.look_around import list_wholes, look_around
from sdm.kernels.winding.looks.mixed_descent import ROOM
from sdm.kernels.winding.looks.records import new_records
from sdm.kernels.winding.looks.see_boxes import BLOCKS as SEERS
from sdm.kernels.winding.looks.see_boxes import SEE_BOXES
from sdm.kernels.winding.looks.settle_boxes import BLOCKS as SETTLERS
from sdm.kernels.winding.looks.settle_boxes import settle_boxes
from sdm.kernels.winding.near_caps import FULL
from sdm.kernels.winding.rims.doubtful_voxels import open_doubtful
from sdm.kernels.winding.rims.exact_voxels import groups_at_work, sum_exactly
from sdm.kernels.winding.rims.single_voxels import sum_voxels

# The first boxes are the smallest ones of which there are no more than this: a GPU has to be filled, and a launch costs
# more than looking at a box.
MOST_FIRST = {"cuda": 8192, "cpu": 16}
# What a node of the tree, or a cap, may add to the error of the winding number there; how many near caps there may be
# to look at one by one, and how many to add voxel by voxel. Boxes of 4^3 are the last of a GPU; bands go on.
TOLERANCES = {"cuda": (4e-3, 2e-3, 1e-3, 2e-4, 1e-5, 5e-6, 1e-6), "cpu": (4e-3, 2e-3, 1e-3, 7e-5, 2e-5, 3e-6, 3e-7)}
LISTED = {kind: (0, 0, 64, *4 * [most]) for kind, most in MOST_NEAR.items()}
SETTLED = {"cuda": (0, 0, 8, *4 * [MOST_NEAR["cuda"]]), "cpu": (0, 0, 12, *4 * [MOST_NEAR["cpu"]])}
LAST = BITS.index(2)
# A GPU's for boxes of 4^3 where faces are the caps: hundreds of nodes are near each, and few voxels are left even so.
LAST_OF_FACES = 5e-4
# What a node may add where boxes of 4^3 are looked at again, and once more; whether these looks begin with what the box
# of 8^3 around has found (`looks.look_around`); room for nodes and caps near such a box.
AGAIN = 1e-5, 1e-6
AROUND = 1, 0
ROOM_AGAIN = ROOM
# Voxels that these leave in doubt are listed, as long as there is room: for one of so many of a map, and for so many.
VOXELS_OF, LEAST_VOXELS = 128, 1 << 14
# Caps under a node that are added to eight voxels at once in less time than to a field.
FEW = 2
# Where boxes are left to the sums over all caps (`rims.doubtful_voxels`) before any look again: the size in bits of the
# smallest that are looked at, if a mesh has no more edges, and a map no more voxels, than this: a small map waits for
# launches rather than for sums.
SUMMED: tuple[tuple[int, float, float], ...] = ((3, 64, math.inf), (2, 1300, math.inf), (2, 3000, 1 << 21))
# Groups of lanes of a GPU that have work, of so many: with fewer, octants do not share what is found for all of them.
FEWEST_ITEMS = 5, 4
# Boxes that are recorded at a time, at most; and near caps of these, for one of so many voxels, but never less or more.
# Boxes for which there is no room are left to what comes after.
MOST_RECORDS, NEAR_OF, ROOM_FOR_NEAR = 1 << 18, 2, (1 << 20, 1 << 23)


def first_level(meshes: int, shape: list[int], most: int) -> int:
    """The level that a batch of maps of this shape begins with: of `most` boxes at most, and at the latest of 4^3."""
    level = 0
    while level < LAST:
        if meshes * math.prod(-(-n >> BITS[level + 1]) for n in shape) > most:
            break
        level += 1
    return level


def open_caps(
    tree: Tree, boundary: Boundary, caps: Caps, slab: Slab, values: wp.array, empty: Callable[[int, Any], wp.array]
) -> wp.array:
    """From the winding numbers of surface and caps to the surface's own, where it matters for sign or clearness.

    Changes `values` (meshes, n, ny, nz) float32. `empty(length, dtype)` allocates workspace. Returns the
    counts, (COUNTS) int32.
    """
    device = values.device
    meshes, *shape = values.shape
    lanes, workers, kind = 1, 16 * threads(), "cpu"
    if device.is_cuda:
        lanes, workers, kind = GPU_LANES, gpu_workers(device, BLOCKS_PER_SM), "cuda"
    seers, settlers = (gpu_workers(device, each) if device.is_cuda else workers for each in (SEERS, SETTLERS))
    # Without a memset, for which a GPU waits longer than for a kernel.
    counts = new_zeros(empty, COUNTS + groups_at_work(device))
    stacks = empty(1 if device.is_cuda else workers * LARGE_STACK_ON_CPU, wp.int32)

    def lists() -> tuple[wp.array, wp.array]:
        return empty(meshes * math.prod(cells), wp.int32), empty(meshes * math.prod(cells), wp.int32)

    fewest = FEWEST_ITEMS[0] * seers // FEWEST_ITEMS[1] if device.is_cuda else 0
    fits = (size for size, edges, voxels in SUMMED if boundary.count <= edges and values.size <= voxels)
    smallest, first = next(fits, 0), first_level(meshes, shape, MOST_FIRST[kind])
    cells, level = (1, 1, 1), first
    left = lists()
    last = meshes * math.prod(-(-n >> BITS[LAST]) for n in shape)
    least, most = ROOM_FOR_NEAR
    records = new_records(min(MOST_RECORDS, last), max(least, min(most, values.size // NEAR_OF)), empty)
    while level == first or (level <= LAST and BITS[level] >= smallest):
        bits = BITS[level]
        parents, cells = (wp.vec3i(*(-(-n >> size) for n in shape)) for size in (bits + 1, bits))
        boxes, left = left, lists()
        of_faces = level == LAST and caps.are_faces != 0
        tolerance = LAST_OF_FACES if of_faces else TOLERANCES[kind][level]
        limits = [tolerance * FULL, LISTED[kind][level], SETTLED[kind][level]]
        inputs = [caps, slab, bits, *limits, parents, cells, level, int(level == first), fewest]
        inputs += [*boxes, *left, records, counts, stacks, lanes, values]
        launch(SEE_BOXES[int(caps.are_faces != 0)], seers * lanes, inputs, device, smallest=1)
        inputs = [caps, slab, bits, cells, level, records, *left, counts, lanes, values]
        launch(settle_boxes, settlers * lanes, inputs, device, smallest=1)
        level += 1
    bits, again = BITS[level - 1], AGAIN if BITS[level - 1] > smallest else ()
    voxels = empty(values.size // VOXELS_OF + LEAST_VOXELS if again else 1, wp.int32)
    # Where boxes of 4^3 are looked at again: those of 8^3 around them.
    wholes = wp.vec3i(*(-(-n >> bits + 1) for n in shape))
    some = meshes * math.prod(wholes)
    for look, tolerance in enumerate(again, 1):
        boxes, left = left, lists()
        at, after, slots = STRIDE * level, STRIDE * (level + 1), boxes[0]
        if AROUND[look - 1]:
            listed, slots = empty(some, wp.int32), new_zeros(empty, some)
            inputs = [workers * lanes, cells, wholes, at + LENGTH, at + BOXES_AROUND, boxes[0], listed, slots, counts]
            launch(list_wholes, workers * lanes, inputs, device, smallest=1)
            inputs = [caps, slab, tolerance * FULL, ROOM_AGAIN, wholes, at + BOXES_AROUND, at + NEXT_RECORD]
            inputs += [at + RECORDED, at + RECORDED_NEAR, listed, slots, records, counts, stacks, lanes, values]
            launch(look_around, workers * lanes, inputs, device, smallest=1)
        places = [at + LENGTH, at + NEXT, at + LOOKED if look == 1 else -1, after + LENGTH, UNSURE]
        inputs = [caps, slab, tolerance * FULL, ROOM_AGAIN, cells, *places, int(look == len(again)), wholes, slots]
        inputs += [records, *boxes, *left, voxels, counts, stacks, lanes, values]
        launch(LOOK_AGAIN[AROUND[look - 1]], workers * lanes, inputs, device, smallest=1)
        level += 1
    if again:
        places = [UNSURE, NEXT_UNSURE, STRIDE * ALONE + LOOKED, EXACT]
        exact = empty(voxels.size, wp.int32)
        sum_voxels(tree, caps, slab, voxels, exact, places, counts, values)
        parts = empty(2 * groups_at_work(device), wp.float64)
        sum_exactly(tree, boundary, caps, slab, exact, EXACT, NEXT_EXACT, COUNTS, counts, values, parts)
    places = [STRIDE * level + LENGTH, STRIDE * level + NEXT, STRIDE * ALONE + LOOKED, EXACT]
    inputs = [tree, boundary, caps, 0, slab, bits, cells, fewest, *left, *places, counts, lanes, values]
    launch(open_doubtful, workers * lanes, inputs, device, smallest=1)
    return counts
