"""Winding numbers of a mesh with few boundary edges by the edges alone, on a CPU: eight edges or voxels at once.

Boxes of 8^3 come first (`boxes_handing_down`). What they leave in doubt is looked at as `rims.edge_boxes` has it for a
GPU: boxes of 4^3 with a polynomial of the far strips and a list of the near ones, then the sum over all edges for each
voxel that is left in doubt, in float32 and, where that is not enough, in float64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.voxel_box import box_of_voxels
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.primitives.wide_numbers import SIXTEEN
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.cap_field import ONE_OVER_FULL, doubt, most_change
from sdm.kernels.winding.eight_voxels import place_in_box
from sdm.kernels.winding.eights.box_strips import ROOM as PLACES
from sdm.kernels.winding.eights.box_strips import strips_of_box
from sdm.kernels.winding.eights.box_voxels import OCTANTS, settle_voxels, sixteens_left, write_voxels
from sdm.kernels.winding.eights.boxes_handing_down import (
    FOR_LARGE,
    FOR_OCTANTS,
    KEPT,
    LARGE_BITS,
    MOST_ERROR,
    open_by_octants,
)
from sdm.kernels.winding.eights.exact_sum import exact_share
from sdm.kernels.winding.eights.packed_edges import ROW, look_at_eights, pack_edges, sum_of_eights
from sdm.kernels.winding.looks.count_places import ALONE, BITS, COUNTS, EXACT, LENGTH, LOOKED, NEXT, STRIDE
from sdm.kernels.winding.rims.edge_boxes import TOLERANCES
from sdm.kernels.winding.rims.radial_strips import ACROSS_BOX, NEAR
from sdm.kernels.winding.rims.single_voxels import place_of_voxel
from sdm.kernels.winding.rims.strip_looks import ASIDE, ROOM, WIDER, field_of
from sdm.kernels.winding.settled_boxes import is_left, is_sure, opened

wp.set_module_options({"enable_backward": False})

_ROOM = ROOM["cpu"]
# Of the size of boxes, which `box_voxels` settles.
BOX_BITS = 2
# What an edge's polynomial may leave out of the solid angle in boxes that larger ones have left in doubt.
LEFT_OUT_AGAIN = 2e-3
# Larger boxes come first if there are so many for each thread.
FEWEST_LARGE = 4


@wp.kernel
def _open_boxes_by_eights(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    rows: wp.array(dtype=wp.float32),
    packed: wp.array(dtype=wp.int32),
    blocks: int,
    slab: Slab,
    bits: int,
    tolerance: float,
    cells: wp.vec3i,
    again: wp.array(dtype=wp.int32),
    length_again: int,
    left: wp.array(dtype=wp.int32),
    left_octants: wp.array(dtype=wp.int32),
    next_item: int,
    looked: int,
    length: int,
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.float32),
    values: wp.array4d(dtype=wp.float32),
):
    """Open boxes of 4^3 voxels (`bits` is 2), `cells` along each axis; list those that leave some in doubt.

    All of them, or those that are listed `again`, whose number is at a place of the counts, if that is not negative.
    `next_item`, `looked` and `length` are places of the counts, too.
    """
    stack = large_stack_of(stacks, begin + wp.tid())
    at_places = (begin + wp.tid()) * PLACES
    total = values.shape[0] * cells[0] * cells[1] * cells[2]
    across_room = LARGE_STACK_ON_CPU - _ROOM
    if length_again >= 0:
        total = counts[length_again]
    number = fetch_add_once(counts, next_item, 1, 0)
    while number < total:
        item = number
        if length_again >= 0:
            item = again[number]
        mesh, at = unravel(item, cells)
        which = int(15)
        if length_again >= 0:
            which = sixteens_left(values, mesh, 4 * at, slab.shape - 4 * at)
        scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
        here = slab_of(slab, mesh)
        start = wp.vec3i(at[0] << bits, at[1] << bits, at[2] << bits)
        box = box_of_voxels(here, start, 1 << bits, scale)
        c = box.centre + wp.cw_mul(ASIDE, box.half)
        half = WIDER * box.half
        radius = wp.length(half)
        look = look_at_eights(
            rows, mesh * blocks, packed[mesh], c, radius, half, tolerance,
            stack, 0, _ROOM, _ROOM, across_room,
        )  # fmt: skip
        field = field_of(look, 1)
        near = int(look[NEAR])
        across = int(look[ACROSS_BOX])
        undone = int(0)
        change = most_change(field, half)
        error = doubt(field)
        middle = float(field.value) * ONE_OVER_FULL
        plain = near + across == 0 and is_sure(middle - wp.floor(middle), 1.0, error + change)
        if near > _ROOM or across > across_room or not error < MOST_ERROR:
            undone = int(255)
        else:
            listed = near + across > 0
            if not plain:
                write_voxels(here, start, scale, places, at_places)
                if listed:
                    strips_of_box(
                        rows, mesh * blocks, stack, 0, near, _ROOM, across, c, radius, places, at_places, 64, which
                    )
            undone = settle_voxels(field, here, values, mesh, start, places, at_places, c, plain, listed, 1.0, change)
        fetch_add(counts, looked, 1)
        if undone != 0:
            place = fetch_add(counts, length, 1)
            left[place] = item
            left_octants[place] = undone & (OCTANTS - 1)
        number = fetch_add_once(counts, next_item, 1, 0)


@wp.kernel
def _open_voxels_by_eights(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    rows: wp.array(dtype=wp.float32),
    packed: wp.array(dtype=wp.int32),
    blocks: int,
    slab: Slab,
    bits: int,
    cells: wp.vec3i,
    boxes: wp.array(dtype=wp.int32),
    octants: wp.array(dtype=wp.int32),
    length: int,
    next_item: int,
    looked: int,
    exact: int,
    counts: wp.array(dtype=wp.int32),
    values: wp.array4d(dtype=wp.float32),
):
    """Open what is left of listed boxes, whose octants in doubt have a bit each, by the sum over all edges."""
    half = bits - 1
    item = fetch_add_once(counts, next_item, 1, 0)
    while item < 8 * counts[length]:
        number = item / 8
        octant = item - 8 * number
        mesh, at = unravel(boxes[number], cells)
        inner = int(0)
        if (octants[number] >> octant) & 1:
            inner = 1 << (3 * half)
        o = place_in_box(octant, 1)
        start = wp.vec3i((2 * at[0] + o[0]) << half, (2 * at[1] + o[1]) << half, (2 * at[2] + o[2]) << half)
        for k in range(inner):
            v = start + place_in_box(k, half)
            if is_left(slab, values, mesh, v):
                p = place_of_voxel(tree, slab, mesh, v)
                crossings = values[mesh, v[0], v[1], v[2]]
                found = sum_of_eights(rows, mesh * blocks, packed[mesh], wp.vec3(p))
                if is_sure(crossings + found[0], crossings, found[1]):
                    values[mesh, v[0], v[1], v[2]] = opened(crossings + found[0])
                else:
                    values[mesh, v[0], v[1], v[2]] = crossings + float(exact_share(boundary, tree, mesh, p))
                    fetch_add(counts, exact, 1)
                fetch_add(counts, looked, 1)
        item = fetch_add_once(counts, next_item, 1, 0)


def open_edges_by_eights(
    tree: Tree, boundary: Boundary, slab: Slab, values: wp.array, empty: Callable[[int, Any], wp.array]
) -> wp.array:
    """`rims.edge_boxes.open_edges` on a CPU; the same counts."""
    device = values.device
    meshes, *shape = values.shape
    workers = 16 * threads()
    counts = empty(COUNTS, wp.int32)
    counts.zero_()
    blocks = -(-boundary.count // SIXTEEN)
    rows = empty(meshes * blocks * ROW, wp.float32)
    packed = empty(meshes, wp.int32)
    launch(pack_edges, meshes, [boundary, blocks, rows, packed], device, smallest=1)
    stacks = empty(workers * LARGE_STACK_ON_CPU, wp.int32)
    places = empty(workers * PLACES, wp.float32)
    bits, tolerance = BOX_BITS, TOLERANCES["cpu"]
    level = BITS.index(bits)
    at, after = STRIDE * level, STRIDE * (level + 1)
    cells, large = (wp.vec3i(*(-(-n >> size) for n in shape)) for size in (bits, LARGE_BITS))
    again, left, left_octants = (empty(meshes * cells[0] * cells[1] * cells[2], wp.int32) for _ in range(3))
    length_again = -1
    if meshes * large[0] * large[1] * large[2] >= FEWEST_LARGE * threads():
        length_again, tolerance = at + LENGTH, LEFT_OUT_AGAIN
        kept = empty(workers * KEPT, wp.float32)
        first = STRIDE * BITS.index(LARGE_BITS)
        inputs = [tree, rows, packed, blocks, slab, FOR_LARGE, FOR_OCTANTS, large, cells, again, left, left_octants]
        inputs += [first + NEXT, first + LOOKED, length_again, after + LENGTH, counts, stacks, places, kept, values]
        launch(open_by_octants, workers, inputs, device, smallest=1)
    inputs = [tree, boundary, rows, packed, blocks, slab, bits, tolerance, cells, again, length_again]
    inputs += [left, left_octants, at + NEXT, at + LOOKED, after + LENGTH, counts, stacks, places, values]
    launch(_open_boxes_by_eights, workers, inputs, device, smallest=1)
    inputs = [tree, boundary, rows, packed, blocks, slab, bits, cells, left, left_octants]
    inputs += [after + LENGTH, after + NEXT, STRIDE * ALONE + LOOKED, EXACT, counts, values]
    launch(_open_voxels_by_eights, workers, inputs, device, smallest=1)
    return counts
