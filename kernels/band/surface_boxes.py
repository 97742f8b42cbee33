"""Boxes of voxels near the surface, from large ones to blocks of 8^3: of those that may be near the eighths are tried.

A box may be near if some triangle may be within reach of some point of it. That is found by a descent of the tree which
ends with the first such triangle, so boxes along the surface cost little, and boxes far from it end at the root. Three
bounds tell that a triangle is out of reach: its box, its plane, and its distance from the centre of the voxels.
"""

from __future__ import annotations

import math
from typing import Any

import warp as wp

from sdm.kernels.band.block_bits import BlockBits, mark_block
from sdm.kernels.bvh.nearest_search import NodeStack
from sdm.kernels.bvh.tree import SCALE, Tree, first_triangle, load_corners, node_box, nodes_of, slots_of
from sdm.kernels.geometry.block_table import BITS as BLOCK_BITS
from sdm.kernels.geometry.triangle_distance import nearest_part
from sdm.kernels.geometry.voxel_box import VoxelBox, box_of_voxels, is_within, octant_at
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.launch import launch
from sdm.kernels.primitives.atomics import fetch_add

wp.set_module_options({"enable_backward": False})

# Counts of each level: the next box to look at, and how many there are.
NEXT, LENGTH, STRIDE = 0, 1, 2
# Threads of a launch that are enough to fill a GPU.
MOST_THREADS = 1 << 18
# What rounding adds to a distance, in units of the largest coordinate.
ROUNDING = 1.0e-6


@wp.func
def box_gap2(low: wp.vec3, high: wp.vec3, box: VoxelBox):
    """Squared distance of two boxes."""
    gap = wp.max(wp.max(low - box.centre - box.half, box.centre - box.half - high), wp.vec3())
    return wp.dot(gap, gap)


@wp.func
def triangle_may_reach(a: wp.vec3, b: wp.vec3, c: wp.vec3, n: wp.vec3, box: VoxelBox, reach: float, reach2: float):
    """False only for triangles that are further than `reach` from all points of a box."""
    if box_gap2(wp.min(a, wp.min(b, c)), wp.max(a, wp.max(b, c)), box) > reach2:
        return False
    h = box.half
    across = wp.abs(n[0]) * h[0] + wp.abs(n[1]) * h[1] + wp.abs(n[2]) * h[2]
    if wp.abs(wp.dot(n, box.centre - a)) > reach + across:
        return False
    d2, _part = nearest_part(box.centre, a, b, c, n)
    most = reach + wp.sqrt(box.half2)
    return d2 <= most * most


@wp.func
def is_near(tree: Tree, box: VoxelBox, reach: float):
    """False only for boxes of which all points are further than `reach` from the surface."""
    room = 1.0 + wp.max(wp.abs(box.centre)) + wp.max(box.half)
    within = reach * (1.0 + ROUNDING) + ROUNDING * room
    within2 = within * within
    leaves = 1 << tree.depth
    base = nodes_of(tree, 0)
    nodes = NodeStack()
    waiting = int(0)
    node = int(1)
    low, high = node_box(tree, base + 1)
    if box_gap2(low, high, box) > within2:
        return False
    while node > 0:
        if node >= leaves:
            leaf = node - leaves
            for t in range(first_triangle(tree, leaf), first_triangle(tree, leaf + 1)):
                a, b, c, n = load_corners(tree, slots_of(tree, 0) + t)
                if triangle_may_reach(a, b, c, n, box, within, within2):
                    return True
            node = int(0)
        else:
            # The child whose box is nearer first.
            left = 2 * node
            left_low, left_high = node_box(tree, base + left)
            right_low, right_high = node_box(tree, base + left + 1)
            left2 = box_gap2(left_low, left_high, box)
            right2 = box_gap2(right_low, right_high, box)
            if left2 == 0.0 and right2 == 0.0:
                left2 = wp.length_sq(0.5 * (left_low + left_high) - box.centre) * 1.0e-30
                right2 = wp.length_sq(0.5 * (right_low + right_high) - box.centre) * 1.0e-30
            near = wp.where(right2 < left2, left + 1, left)
            if wp.max(left2, right2) <= within2:
                nodes[waiting] = 2 * left + 1 - near
                waiting = waiting + 1
            node = wp.where(wp.min(left2, right2) <= within2, near, 0)
        if node == 0 and waiting > 0:
            waiting = waiting - 1
            node = nodes[waiting]
    return False


@wp.func
def parent_of(item: int, known: wp.vec3i, parents: wp.array(dtype=wp.vec3i)):
    """The parent that a box is an eighth of: one of all, of which there are `known` along each axis, or of a list."""
    if known[0] == 0:
        return parents[item / 8]
    number = item / 8
    row = number / known[2]
    return wp.vec3i(row / known[1], row % known[1], number % known[2])


@wp.func
def eighths_of_parents(
    level: int, known: wp.vec3i, parents: wp.array(dtype=wp.vec3i), counts: wp.array(dtype=wp.int32)
):
    """Number of boxes to look at; of a list, as many as were counted, and are there."""
    if known[0] == 0:
        return 8 * wp.min(counts[STRIDE * level + LENGTH], parents.shape[0])
    return 8 * known[0] * known[1] * known[2]


@wp.func
def box_is_near(tree: Tree, slab: Slab, reach: float, bits: int, at: wp.vec3i):
    """True for a box of 2^bits voxels that has some of the slab, and may be near."""
    start = wp.vec3i(at[0] << bits, at[1] << bits, at[2] << bits)
    near = bool(False)
    if is_within(slab, start):
        scale = float(tree.frame[SCALE])
        near = is_near(tree, box_of_voxels(slab, start, 1 << bits, scale), reach * scale)
    return near


@wp.kernel
def _find_boxes(
    begin: int,
    workers: int,
    tree: Tree,
    slab: Slab,
    reach: float,
    bits: int,
    level: int,
    room: int,
    known: wp.vec3i,
    parents: wp.array(dtype=wp.vec3i),
    boxes: wp.array(dtype=wp.vec3i),
    counts: wp.array(dtype=wp.int32),
):
    """List the eighths of parents, boxes of 2^bits voxels, that may be near; those without room are counted alone."""
    item = begin + wp.tid()
    total = eighths_of_parents(level, known, parents, counts)
    while item < total:
        at = 2 * parent_of(item, known, parents) + octant_at(item)
        if box_is_near(tree, slab, reach, bits, at):
            place = fetch_add(counts, STRIDE * (level + 1) + LENGTH, 1)
            if place < room:
                boxes[place] = at
        item = item + workers


@wp.kernel
def _mark_boxes(
    begin: int,
    workers: int,
    tree: Tree,
    slab: Slab,
    reach: float,
    level: int,
    known: wp.vec3i,
    parents: wp.array(dtype=wp.vec3i),
    bits: BlockBits,
    counts: wp.array(dtype=wp.int32),
):
    """Set the bits of the eighths of parents, which are blocks, that may be near."""
    item = begin + wp.tid()
    total = eighths_of_parents(level, known, parents, counts)
    while item < total:
        at = 2 * parent_of(item, known, parents) + octant_at(item)
        if box_is_near(tree, slab, reach, BLOCK_BITS, at):
            mark_block(bits, at)
        item = item + workers


def _workers(parents: int, device: Any) -> int:
    # Of a list that is not full, only those at its begin find something to do.
    return min(8 * parents, MOST_THREADS) if device.is_cuda else 8 * parents


def find_boxes(
    tree: Tree,
    slab: Slab,
    reach: float,
    bits: int,
    level: int,
    known: tuple[int, int, int],
    parents: wp.array,
    boxes: wp.array,
    counts: wp.array,
) -> None:
    """List boxes of 2^bits voxels with a voxel that may be within `reach` (in the mesh's unit) of the surface.

    Args:
        tree: Of one mesh.
        slab: The voxels.
        reach: A length.
        bits: See above.
        level: Which of the lists the parents are.
        known: The parents are all boxes twice as large, so many along each axis; zeros if they are listed.
        parents: (n,) vec3i, boxes twice as large, by their place among all of that size; as many as were counted, of
            which those without room are left out.
        boxes: Filled in any order, as far as there is room.
        counts: Of all levels, see `STRIDE`; the length of the next is counted from 0.
    """
    workers = _workers(math.prod(known) or parents.shape[0], boxes.device)
    inputs = [workers, tree, slab, reach, bits, level, boxes.shape[0], wp.vec3i(*known), parents, boxes, counts]
    launch(_find_boxes, workers, inputs, boxes.device, smallest=8)


def mark_boxes(
    tree: Tree,
    slab: Slab,
    reach: float,
    level: int,
    known: tuple[int, int, int],
    parents: wp.array,
    bits: Any,
    counts: wp.array,
) -> None:
    """`find_boxes` of the last level, whose boxes are blocks: set their bits in `bits`, see `BlockBits`."""
    workers = _workers(math.prod(known) or parents.shape[0], counts.device)
    inputs = [workers, tree, slab, reach, level, wp.vec3i(*known), parents, bits, counts]
    launch(_mark_boxes, workers, inputs, counts.device, smallest=8)
