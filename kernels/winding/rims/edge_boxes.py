"""Winding numbers of a mesh with few boundary edges, by the edges alone: without caps or a tree.

The winding number is the crossings of the surface plus the boundary's share (`boundary_term`), and changes within a box
of voxels, where it does not jump, by the boundary alone (Biot and Savart): so a box gets the share at its centre, by
the sum over all edges (`float32_sum`), and polynomials of the edges that are far for its size (`strip_polynomials`).

What the others add is summed up for each voxel.

A box of 8^3 voxels looks at all edges, its octants at those that were not far for it; what is left in doubt gets the
sum over all edges (`doubtful_voxels`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.voxel_box import VoxelBox, box_of_voxels, is_within, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel, voxel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import (
    BLOCKS_PER_SM,
    GPU_LANES,
    bits_of_lanes,
    gpu_workers,
    sum_of_lanes,
    unknown,
    wait_for_lanes,
)
from sdm.kernels.primitives.shared_stacks import LARGE_STACK, LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.boundary_term import Boundary, edges_of
from sdm.kernels.winding.cap_field import Field, doubt, largest_share, most_change, moved_field, share_at
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.eight_voxels import place_in_box
from sdm.kernels.winding.near_caps import FULL, UNIT
from sdm.kernels.winding.open_caps import ALONE, BITS, COUNTS, EXACT, LENGTH, LOOKED, NEXT, STRIDE
from sdm.kernels.winding.rims.doubtful_voxels import open_doubtful
from sdm.kernels.winding.rims.float32_sum import listed_sum, rim_part
from sdm.kernels.winding.rims.strip_polynomials import see_edges
from sdm.kernels.winding.settled_boxes import LARGEST_SHARE, MOST_DOUBT, is_sure, is_whole, opened

wp.set_module_options({"enable_backward": False})

# Room in a stack for the edges that are not far for a box, and for an octant.
ROOM = 1152
ROOM_OF_OCTANT = LARGE_STACK - ROOM


@wp.func
def with_share(field: Field, found: wp.vec2):
    """A field to which each lane adds a share of the winding number, give or take an error."""
    share = sum_of_lanes(found[0])
    field.value = field.value + wp.float64(FULL * share)
    field.error = field.error + FULL * (sum_of_lanes(found[1]) + 8.0 * UNIT * (1.0 + wp.abs(share)))
    return field


@wp.func
def settle_octant(
    boundary: Boundary,
    field: Field,
    near: int,
    stack: wp.array(dtype=wp.int32),
    place: int,
    slab: Slab,
    mesh: int,
    start: wp.vec3i,
    bits: int,
    box: VoxelBox,
    scale: float,
    lane: int,
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Write the winding numbers of an octant's voxels that are sure; a bit for each octant of it that holds others."""
    left = int(0)
    change = most_change(field, box.half)
    error = doubt(field)
    middle = float(field.value) / FULL
    far = near == 0 and largest_share(field, change) < LARGEST_SHARE
    plain = near == 0 and is_sure(middle - wp.floor(middle), 1.0, error + change)
    if not error < MOST_DOUBT:
        left = int(255)
    elif not far:
        number = lane
        while number < 1 << (3 * bits):
            at = place_in_box(number, bits)
            v = start + at
            whole = float(0.5)
            if is_within(slab, v):
                whole = values[mesh, v[0], v[1], v[2]]
            if is_whole(whole):
                share = middle
                wrong = error + change
                if not plain:
                    p = scale * voxel(slab_of(slab, mesh), v[0], v[1], v[2])
                    found = wp.vec2()
                    if near > 0:
                        found = listed_sum(boundary.ends, stack, place, near, p, 0, 1)
                    share = share_at(field, p - box.centre) + found[0]
                    wrong = error + found[1] + 4.0 * UNIT * wp.abs(found[0])
                if is_sure(whole + share, whole, wrong):
                    values[mesh, v[0], v[1], v[2]] = opened(whole + share)
                else:
                    half = bits - 1
                    left = left | (1 << (4 * (at[0] >> half) + 2 * (at[1] >> half) + (at[2] >> half)))
            number = number + lanes
    return bits_of_lanes(left)


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM))
def _open_by_edges(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    slab: Slab,
    bits: int,
    tolerance: float,
    tolerance_of_octant: float,
    parents: wp.vec3i,
    cells: wp.vec3i,
    fewest: int,
    left: wp.array(dtype=wp.int32),
    left_octants: wp.array(dtype=wp.int32),
    next_item: int,
    looked: int,
    length: int,
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open boxes of 2^(bits + 1) voxels along each edge, octant by octant; list what they leave in doubt.

    `parents` boxes and `cells` octants are along each axis. A box is some items of work where there would be fewer than
    `fewest`. `next_item`, `looked` and `length` are places of the counts.
    """
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = large_stack_of(stacks, thread / lanes)
    total = values.shape[0] * parents[0] * parents[1] * parents[2]
    pieces = int(1)
    while pieces < 8 and total * pieces < fewest:
        pieces = 2 * pieces
    item = fetch_add_once(counts, next_item, 1, lane)
    while item < total * pieces:
        number = item / pieces
        mesh, at = unravel(number, parents)
        scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
        first = mesh * boundary.count
        count = edges_of(boundary)
        begins = wp.vec3i(at[0] << (bits + 1), at[1] << (bits + 1), at[2] << (bits + 1))
        whole_box = box_of_voxels(slab_of(slab, mesh), begins, 2 << bits, scale)
        whole = Field()
        listed = int(0)
        # The box, then its octants: one loop, as a GPU keeps few instructions at hand.
        for step in range(unknown(9)):
            octant = wp.max(step - 1, 0)
            child = 2 * at + octant_at(octant)
            start = wp.vec3i(child[0] << bits, child[1] << bits, child[2] << bits)
            looks = step == 0
            if octant / (8 / pieces) == item % pieces and is_within(slab, start) and not whole.error < 0.0:
                looks = bool(True)
            if looks:
                box = whole_box
                field = Field()
                found = wp.vec2()
                edges = int(count)
                place = int(0)
                room = int(ROOM)
                allowed = float(tolerance)
                if step == 0:
                    found = rim_part(boundary, mesh, box.centre, lane, lanes)
                else:
                    box = box_of_voxels(slab_of(slab, mesh), start, 1 << bits, scale)
                    field = moved_field(whole, box.centre - whole_box.centre)
                    found = listed_sum(boundary.ends, stack, 0, listed, box.centre, lane, lanes)
                    edges = listed
                    place = ROOM
                    room = ROOM_OF_OCTANT
                    allowed = tolerance_of_octant
                seen = see_edges(
                    boundary, first, edges, wp.where(step == 0, 0, 1), box, allowed, stack, 0, place, room, field, lane,
                    lanes,
                )  # fmt: skip
                near = wp.min(seen.near, room)
                # What is listed is no part of the field: it is added for each octant, or voxel.
                less = listed_sum(boundary.ends, stack, place, near, box.centre, lane, lanes)
                field = with_share(with_share(seen.field, found), wp.vec2(-less[0], less[1]))
                if step == 0:
                    whole = field
                    listed = near
                    if near == 0 and largest_share(whole, most_change(whole, box.half)) < LARGEST_SHARE:
                        # Nothing is in doubt.
                        whole.error = -1.0
                else:
                    undone = settle_octant(
                        boundary, field, near, stack, ROOM, slab, mesh, start, bits, box, scale,
                        lane, lanes, values,
                    )  # fmt: skip
                    if lane == 0:
                        fetch_add(counts, looked, 1)
                        if undone != 0:
                            number_left = fetch_add(counts, length, 1)
                            left[number_left] = ((mesh * cells[0] + child[0]) * cells[1] + child[1]) * cells[2] + child[
                                2
                            ]
                            left_octants[number_left] = undone
                # All have read the list before another takes its place.
                wait_for_lanes()
        item = fetch_add_once(counts, next_item, 1, lane)


# A mesh with no more boundary edges than this, and for each from one to that many faces, is opened by them: loose
# sheets and open boxes, whose caps are as large as they are, and so near for most boxes. Others are opened by caps.
MOST_EDGES = {"cuda": 1300, "cpu": 0}
FACES_AN_EDGE = 1, 5
# What an edge's polynomial may leave out of the winding number, for a box and for an octant.
TOLERANCES = {"cuda": (1e-3, 1e-3), "cpu": (1e-4, 1e-4)}
# Bits of the size of octants: of boxes of 8^3 voxels.
OCTANT_BITS = {"cuda": 2, "cpu": 2}


def open_edges(
    tree: Tree, boundary: Boundary, caps: Caps, slab: Slab, values: wp.array, empty: Callable[[int, Any], wp.array]
) -> wp.array:
    """From the crossings of the surface to its winding numbers, where it matters for sign or clearness.

    Changes `values` (meshes, n, ny, nz) float32. `empty(length, dtype)` allocates workspace. Returns the
    counts, as `open_caps` has them.
    """
    device = values.device
    meshes, *shape = values.shape
    lanes, workers, fewest = 1, 16 * threads(), 0
    if device.is_cuda:
        lanes, workers = GPU_LANES, gpu_workers(device, BLOCKS_PER_SM)
        fewest = workers
    kind = "cuda" if device.is_cuda else "cpu"
    counts = empty(COUNTS, wp.int32)
    counts.zero_()
    stacks = empty(1 if device.is_cuda else workers * LARGE_STACK_ON_CPU, wp.int32)
    bits = OCTANT_BITS[kind]
    level = BITS.index(bits)
    parents, cells = (wp.vec3i(*(-(-n >> size) for n in shape)) for size in (bits + 1, bits))
    left, left_octants = (empty(meshes * cells[0] * cells[1] * cells[2], wp.int32) for _ in range(2))
    at, after = STRIDE * level, STRIDE * (level + 1)
    inputs = [tree, boundary, slab, bits, *(FULL * one for one in TOLERANCES[kind]), parents, cells, fewest]
    inputs += [left, left_octants, at + NEXT, at + LOOKED, after + LENGTH, counts, stacks, lanes, values]
    launch(_open_by_edges, workers * lanes, inputs, device, smallest=1)
    inputs = [tree, boundary, caps, 1, slab, bits, cells, fewest, left, left_octants]
    inputs += [after + LENGTH, after + NEXT, STRIDE * ALONE + LOOKED, EXACT, counts, lanes, values]
    launch(open_doubtful, workers * lanes, inputs, device, smallest=1)
    return counts
