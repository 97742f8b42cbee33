"""Opening of an open mesh's caps: from the whole winding numbers of surface and caps to the surface's own.

What has to be right is on which side of 0.25, 0.5 and 0.75 the winding number of a voxel is: that is sign and
clearness. Boxes of 32^3 voxels are looked at first (`sdm.kernels.winding.cap_field`). Where the caps' share is less
than a quarter all over a box, its whole numbers will do; where the field's error leaves no voxel in doubt, the field's
values are taken; else its octants are looked at, down to 4^3 voxels on a GPU and 2^3 on a CPU: each octant from what
the tree's descent for the whole box has found (`sdm.kernels.winding.cap_descent`). What the last leave in doubt they
look at again, with a smaller tolerance. On a GPU what is in doubt even so gets the sum over all caps in float32
(`rims.doubtful_voxels`), and what is still, that over all boundary edges in float64, as `boundary_term` has it: so
every voxel is on the side where that is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.voxel_box import box_of_lane, box_of_voxels, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import (
    BLOCKS_PER_SM,
    GPU_LANES,
    bit_at,
    gpu_workers,
    int_from_lane,
    one_on_cpu,
    unknown,
    wait_for_lanes,
)
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.cap_descent import MOST_NEAR, see_caps
from sdm.kernels.winding.cap_field import Field, doubt, field_of_lane, moved_field
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.near_caps import FULL, WIDER, near_list_of
from sdm.kernels.winding.octants import count_bits, is_one, octants_to_open, parts_of_lanes
from sdm.kernels.winding.rims.doubtful_voxels import open_doubtful, open_voxel, place_of_voxel
from sdm.kernels.winding.settled_boxes import MOST_DOUBT, is_left, settle_box, settle_octants

wp.set_module_options({"enable_backward": False})

# Boxes of 2^5 voxels along each edge, and so on; single voxels twice.
BITS = (5, 4, 3, 2, 1, 0, 0)
# The first boxes are the smallest ones of which there are no more than this: a GPU has to be filled, and a launch costs
# more than looking at a box. Those of 2^3 are listed for what follows.
MOST_FIRST = {"cuda": 8192, "cpu": 16}
LISTED_BITS = 1
LISTED_LEVEL = BITS.index(LISTED_BITS) + 1
# What a node of the tree, or a cap, may add to the error of the winding number there; how many near caps there may be
# to look at one by one, and how many to add voxel by voxel.
TOLERANCES = {"cuda": (4e-3, 2e-3, 1e-3, 2e-4, 1e-5, 5e-6, 1e-6), "cpu": (4e-3, 2e-3, 1e-3, 7e-5, 2e-5, 3e-6, 3e-7)}
LISTED = {kind: (0, 0, 64, *4 * [most]) for kind, most in MOST_NEAR.items()}
SETTLED = {"cuda": (0, 0, 8, *4 * [MOST_NEAR["cuda"]]), "cpu": (0, 0, 12, *4 * [MOST_NEAR["cpu"]])}
# What boxes of twice so many voxels along each edge, 2^bits, leave in doubt is looked at by such boxes again instead of
# by smaller ones, or none with -1: with such a tolerance, such room for near caps, and Taylor polynomials for boxes of
# 2^bits and more.
TOGETHER = {"cuda": 1, "cpu": 0}
AGAIN = {"cuda": (4e-6, 960, 0), "cpu": (3e-6, MOST_NEAR["cpu"], 3)}
# Where that leaves more near caps than there is room for, so many more looks, each with so many times the tolerance.
TRIES, LARGER = 6, 4.0
# So many of the smallest sizes of boxes do without Taylor polynomials: near caps cost a CPU, which adds them for eight
# voxels at once, less than those do.
PLAIN = {"cuda": 0, "cpu": 3}
# Caps under a node that are added to eight voxels at once in less time than to a field.
FEW = 2
# Where boxes are left to the sums over all caps (`rims.doubtful_voxels`) before any look again: the size in bits of the
# smallest that are looked at, if a mesh has no more edges, and a map no more voxels, than this: a small map waits for
# launches rather than for sums.
ANY = math.inf
SUMMED: dict[str, tuple[tuple[int, float, float], ...]] = {
    "cuda": ((3, 64, ANY), (2, 1300, ANY), (2, 3000, 1 << 21)),
    "cpu": (),
}
# Groups of lanes of a GPU that have work, of so many: with fewer, octants do not share what is found for all of them.
FEWEST_ITEMS = 3, 4
# Places of the counts: for each level, and for the sums over all edges, which box is next, how many there are, and how
# many of their octants, or voxels, were looked at.
NEXT, LENGTH, LOOKED, STRIDE = 0, 1, 2, 3
EXACT = STRIDE * len(BITS) + LOOKED
ALONE = BITS.index(0)
COUNTS = EXACT + 1


@wp.func
def voxel_of_piece(piece: int, octant: int, cells: wp.vec3i):
    """The mesh and the indices of a voxel of a box of 2^3, of which there are so many along each axis."""
    mesh, at = unravel(piece, cells)
    return mesh, 2 * at + octant_at(octant)


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM))
def _open_boxes(
    begin: int,
    caps: Caps,
    slab: Slab,
    bits: int,
    tolerance: float,
    listed: int,
    settled: int,
    parents: wp.vec3i,
    cells: wp.vec3i,
    level: int,
    first: int,
    fewest: int,
    together: int,
    plain: int,
    boxes: wp.array(dtype=wp.int32),
    octants: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    left_octants: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open octants, of 2^bits voxels along each edge, of boxes; those that are left in doubt are listed, with theirs.

    Octants of boxes of 2^3 are their single voxels: those that are left are left for what comes after.
    One group of lanes descends for a box, and then its parts for its octants from what that has found; unless boxes are
    so few that there would be fewer than `fewest` items of work: then a box is some of them.
    """
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = large_stack_of(stacks, thread / lanes)
    total = values.shape[0] * parents[0] * parents[1] * parents[2]
    if first == 0:
        total = counts[STRIDE * wp.min(level, LISTED_LEVEL) + LENGTH]
    pieces = int(1)
    while pieces < 8 and total * pieces < fewest:
        pieces = 2 * pieces
    share = 8 / pieces
    item = fetch_add_once(counts, STRIDE * level + NEXT, 1, lane)
    while item < total * pieces:
        number = item / pieces
        some = ((1 << share) - 1) << (share * (item % pieces))
        if first == 0:
            if bits > 0:
                some = some & octants[number]
            number = boxes[number]
        mesh, at = unravel(number, parents)
        some = octants_to_open(slab, values, mesh, at, bits, some)
        scale = float(caps.tree.frame[mesh * FRAME_SIZE + SCALE])
        whole = Field()
        whole.error = float(wp.inf)
        middle = wp.vec3()
        reach = float(0.0)
        again = together != 0
        limit = float(tolerance)
        tries = int(0)
        expand = bits >= plain
        few = wp.where(bits < wp.min(plain, 2), FEW, 0)
        # First the box, then its octants: as many beside each other as what is near leaves room for.
        keep = not again and not is_one(some)
        while some != 0:
            parts = int(1)
            if not keep and not again and whole.error < wp.inf:
                parts = parts_of_lanes(some, whole.near, lanes)
            parts = one_on_cpu(parts)
            part = one_on_cpu(lanes / parts)
            octant = bit_at(some, lane / part)
            idle = octant > 7
            child = 2 * at
            size = 2 << bits
            if not keep and not again:
                child = child + octant_at(octant)
                size = 1 << bits
            start = wp.vec3i(child[0] << bits, child[1] << bits, child[2] << bits)
            box = box_of_voxels(slab_of(slab, mesh), start, size, scale)
            radius = wp.sqrt(box.half2)
            field = Field()
            handed = int(-1)
            if keep:
                middle = box.centre
                radius = radius * WIDER
                reach = radius
            else:
                way = box.centre - middle
                if whole.error < wp.inf and wp.length(way) + radius <= reach:
                    field = moved_field(whole, way)
                    handed = whole.near
            field = see_caps(
                caps,
                mesh,
                box.centre,
                radius,
                limit,
                listed,
                field,
                handed,
                keep,
                expand,
                wp.where(keep, 0, few),
                stack,
                lane,
                lanes,
                part,
                idle,
            )
            if keep:
                whole = field
                keep = bool(False)
            elif again and tries < TRIES and field.near == 0 and doubt(field) > MOST_DOUBT:
                # More are near than there is room for.
                limit = limit * LARGER
                tries = tries + 1
            elif again and bits > 0:
                undone = settle_octants(
                    field,
                    caps,
                    stack,
                    slab,
                    mesh,
                    start,
                    bits,
                    some,
                    settled,
                    box,
                    scale,
                    near_list_of(lane, part),
                    lane,
                    lanes,
                    values,
                )
                if lane == 0:
                    fetch_add(counts, STRIDE * level + LOOKED, count_bits(some))
                    if undone != 0:
                        place = fetch_add(counts, STRIDE * (level + 1) + LENGTH, 1)
                        left[place] = number
                        left_octants[place] = undone
                some = int(0)
                wait_for_lanes()
            else:
                # Large boxes have voxels for all lanes, one box after the other.
                turns = wp.where(bits > 1, parts, 1)
                workers = wp.where(bits > 1, lanes, part)
                for turn in range(unknown(turns)):
                    seen = field
                    seen_box = box
                    number_of_octant = octant
                    first_lane = lane
                    if turns > 1:
                        first_lane = turn * part
                        seen = field_of_lane(field, first_lane)
                        number_of_octant = int_from_lane(octant, first_lane)
                        child = 2 * at + octant_at(number_of_octant)
                        start = wp.vec3i(child[0] << bits, child[1] << bits, child[2] << bits)
                        seen_box = box_of_lane(box, first_lane)
                    undone = settle_box(
                        seen,
                        caps,
                        stack,
                        slab,
                        mesh,
                        start,
                        wp.where(again, 1, bits),
                        bits == 0,
                        settled,
                        seen_box,
                        scale,
                        near_list_of(first_lane, part),
                        lane & (workers - 1),
                        workers,
                        number_of_octant > 7,
                        values,
                    )
                    if (lane & (workers - 1)) == 0 and number_of_octant < 8:
                        fetch_add(counts, STRIDE * level + LOOKED, wp.where(again, count_bits(some), 1))
                        if bits > 0 and undone != 0:
                            place = fetch_add(counts, STRIDE * (level + 1) + LENGTH, 1)
                            left[place] = ((mesh * cells[0] + child[0]) * cells[1] + child[1]) * cells[2] + child[2]
                            left_octants[place] = undone
                for _part in range(unknown(parts)):
                    some = some & (some - 1)
                if again:
                    some = int(0)
                # All have read the lists before others take their place.
                wait_for_lanes()
        item = fetch_add_once(counts, STRIDE * level + NEXT, 1, lane)


@wp.kernel
def _open_exactly(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    caps: Caps,
    slab: Slab,
    cells: wp.vec3i,
    level: int,
    pieces: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open what is still left of boxes of 2^3 in float64."""
    lane = (begin + wp.tid()) % lanes
    total = 8 * counts[STRIDE * LISTED_LEVEL + LENGTH]
    item = fetch_add_once(counts, STRIDE * level + NEXT, 1, lane)
    while item < total:
        mesh, v = voxel_of_piece(pieces[item / 8], item, cells)
        if is_left(slab, values, mesh, v):
            p = place_of_voxel(tree, slab, mesh, v)
            winding = open_voxel(tree, boundary, caps, mesh, p, values[mesh, v[0], v[1], v[2]], lane, lanes)
            # All lanes have read the whole number before it goes.
            wait_for_lanes()
            if lane == 0:
                values[mesh, v[0], v[1], v[2]] = winding
                fetch_add(counts, EXACT, 1)
        item = fetch_add_once(counts, STRIDE * level + NEXT, 1, lane)


def first_level(meshes: int, shape: list[int], most: int) -> int:
    """The level that a batch of maps of this shape begins with: of `most` boxes at most, and at the latest of 4^3."""
    level = 0
    while BITS[level] > LISTED_BITS + 1:
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
    lanes, workers = 1, 16 * threads()
    if device.is_cuda:
        lanes, workers = GPU_LANES, gpu_workers(device, BLOCKS_PER_SM)
    counts = empty(COUNTS, wp.int32)
    counts.zero_()
    stacks = empty(1 if device.is_cuda else workers * LARGE_STACK_ON_CPU, wp.int32)
    kind = "cuda" if device.is_cuda else "cpu"
    boxes = octants = left = left_octants = empty(1, wp.int32)
    cells = wp.vec3i()
    first = first_level(meshes, shape, MOST_FIRST[kind])
    fewest = FEWEST_ITEMS[0] * workers // FEWEST_ITEMS[1] if device.is_cuda else 0
    fits = (size for size, edges, voxels in SUMMED[kind] if boundary.count <= edges and values.size <= voxels)
    smallest = next(fits, 0)
    again, of_left = TOGETHER[kind], 0
    for level in range(first, len(BITS)):
        bits = BITS[level]
        if level > first and (bits < smallest or of_left > bits + 1):
            at = [STRIDE * level + LENGTH, STRIDE * level + NEXT, STRIDE * ALONE + LOOKED, EXACT]
            inputs = [tree, boundary, caps, 0, slab, of_left, cells, fewest, left, left_octants, *at, counts]
            launch(open_doubtful, workers * lanes, [*inputs, lanes, values], device, smallest=1)
            return counts
        parents, cells = (wp.vec3i(*(-(-n >> size) for n in shape)) for size in (bits + 1, bits))
        if bits > 0:
            boxes, octants = left, left_octants
            left, left_octants = (empty(meshes * cells[0] * cells[1] * cells[2], wp.int32) for _ in range(2))
        together = bits == again
        tolerance, room, plain = TOLERANCES[kind][level], LISTED[kind][level], PLAIN[kind]
        limits = [tolerance * FULL, room, SETTLED[kind][level]]
        if together:
            tolerance, room, plain = AGAIN[kind]
            limits = [tolerance * FULL, room, room]
        listed = [left, left_octants] if bits == 0 else [boxes, octants]
        inputs = [caps, slab, bits, *limits, parents, cells, level, int(level == first)]
        inputs += [0 if together else fewest, int(together), plain, *listed]
        inputs += [left, left_octants, counts, stacks, lanes, values]
        launch(_open_boxes, workers * lanes, inputs, device, smallest=1)
        of_left = bits
        if together and bits > 0:
            cells, of_left = parents, bits + 1
    inputs = [tree, boundary, caps, slab, parents, len(BITS), left, counts, lanes, values]
    launch(_open_exactly, workers * lanes, inputs, device, smallest=1)
    return counts
