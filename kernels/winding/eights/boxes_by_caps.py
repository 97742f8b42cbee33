"""Opening of an open mesh's caps on a CPU, from boxes of 4^3 voxels on, eight voxels at once.

As `open_caps` has it for larger boxes and for a GPU; with nodes that are far for a voxel, but not for its box, added to
voxels (`near_nodes`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree, tree_of
from sdm.kernels.geometry.voxel_box import box_of_voxels, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel, voxel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import bit_at
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.cap_field import Field, doubt, largest_share, most_change, moved_field, share_at
from sdm.kernels.winding.cap_tree import MOMENTS_SIZE, Caps
from sdm.kernels.winding.eight_voxels import Eight, Sixteen, place_in_box
from sdm.kernels.winding.eights.box_nodes import nodes_of_box
from sdm.kernels.winding.eights.box_strips import ROOM as PLACES
from sdm.kernels.winding.eights.box_voxels import OCTANTS, octants_left, settle_voxels, write_voxels
from sdm.kernels.winding.eights.exact_sum import exact_share
from sdm.kernels.winding.eights.large_boxes import open_large_boxes
from sdm.kernels.winding.eights.near_nodes import (
    CUBES,
    DRIFT,
    ERROR,
    HIGH,
    LENGTH,
    LOW,
    PRODUCTS,
    SLOPE,
    SQUARES,
    Seen,
    see_nodes,
)
from sdm.kernels.winding.eights.node_angles import angles_of_nodes
from sdm.kernels.winding.eights.node_table import HAND_DOWN, HANDED, MIXED, ROW, STACK, TO_VOXELS, pack_nodes
from sdm.kernels.winding.eights.node_table import LISTED as LISTED_AT
from sdm.kernels.winding.looks.count_places import BITS, COUNTS, EXACT, LOOKED, NEXT, STRIDE
from sdm.kernels.winding.looks.count_places import LENGTH as OF_LISTED
from sdm.kernels.winding.near_caps import FULL, WIDER
from sdm.kernels.winding.octants import count_bits, is_one, octants_to_open
from sdm.kernels.winding.open_caps import LISTED, MOST_FIRST, SETTLED, TOLERANCES, first_level
from sdm.kernels.winding.rims.single_voxels import place_of_voxel, without_caps
from sdm.kernels.winding.settled_boxes import LARGEST_SHARE, MOST_DOUBT, is_left, is_sure, opened

wp.set_module_options({"enable_backward": False})

_HAND_DOWN, _HANDED, _LISTED = (wp.constant(number) for number in (HAND_DOWN, HANDED, LISTED_AT))
# Boxes of 2^3 are listed for what follows.
LISTED_LEVEL = BITS.index(1) + 1


@wp.func
def with_seen(field: Field, seen: Seen):
    """A field and what a descent has added to it."""
    field.value = field.value + wp.float64(seen[HIGH]) + wp.float64(seen[LOW])
    for axis in range(3):
        field.slope[axis] = field.slope[axis] + seen[SLOPE + axis]
        field.squares[axis] = field.squares[axis] + seen[SQUARES + axis]
        field.products[axis] = field.products[axis] + seen[PRODUCTS + axis]
    for number in range(7):
        field.cubes[number] = field.cubes[number] + seen[CUBES + number]
    field.error = field.error + seen[ERROR]
    field.drift = field.drift + seen[DRIFT]
    field.near = int(seen[LENGTH])
    return field


@wp.func
def voxel_of_piece(piece: int, octant: int, cells: wp.vec3i):
    """The mesh and the indices of a voxel of a box of 2^3, of which there are so many along each axis."""
    mesh, at = unravel(piece, cells)
    return mesh, 2 * at + octant_at(octant)


@wp.kernel
def open_boxes_by_eights(
    begin: int,
    caps: Caps,
    rows: wp.array(dtype=wp.float32),
    slab: Slab,
    bits: int,
    tolerance: float,
    mode: int,
    parents: wp.vec3i,
    cells: wp.vec3i,
    level: int,
    first: int,
    boxes: wp.array(dtype=wp.int32),
    octants: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    left_octants: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.float32),
    values: wp.array4d(dtype=wp.float32),
):
    """Open octants, of 2^bits voxels along each edge, of boxes; those that are left in doubt are listed, with theirs.

    Octants of boxes of 2^3 are their voxels: such a box is looked at as one.
    """
    at_stack = (begin + wp.tid()) * STACK
    at_places = (begin + wp.tid()) * PLACES
    total = values.shape[0] * parents[0] * parents[1] * parents[2]
    if first == 0:
        total = counts[STRIDE * wp.min(level, LISTED_LEVEL) + OF_LISTED]
    again = bits == 0
    size = wp.max(bits, 1)
    item = fetch_add_once(counts, STRIDE * level + NEXT, 1, 0)
    while item < total:
        number = item
        some = int(255)
        if first == 0:
            number = boxes[item]
            if not again:
                some = octants[item]
        mesh, at = unravel(number, parents)
        some = octants_to_open(slab, values, mesh, at, bits, some)
        here = slab_of(slab, mesh)
        scale = float(caps.tree.frame[mesh * FRAME_SIZE + SCALE])
        one = tree_of(caps.tree, mesh)
        leaves = 1 << one.depth
        whole = Field()
        whole.error = float(wp.inf)
        middle = wp.vec3()
        reach = float(0.0)
        if not again and not is_one(some):
            # First the box, then its octants, from what is near it.
            start = wp.vec3i(at[0] << (bits + 1), at[1] << (bits + 1), at[2] << (bits + 1))
            around = box_of_voxels(here, start, 2 << bits, scale)
            middle = around.centre
            reach = wp.sqrt(around.half2) * WIDER
            seen = see_nodes(
                caps.moments,
                rows,
                one.root,
                leaves,
                stacks,
                at_stack,
                -1,
                middle,
                reach,
                tolerance,
                _HAND_DOWN,
                _HANDED,
            )
            whole = with_seen(Field(), seen)
        while some != 0:
            octant = bit_at(some, 0)
            child = at
            if not again:
                child = 2 * at + octant_at(octant)
            start = wp.vec3i(child[0] << size, child[1] << size, child[2] << size)
            box = box_of_voxels(here, start, 1 << size, scale)
            radius = wp.sqrt(box.half2)
            field = Field()
            handed = int(-1)
            way = box.centre - middle
            if whole.error < wp.inf and wp.length(way) + radius <= reach:
                field = moved_field(whole, way)
                handed = whole.near
            field = with_seen(
                field,
                see_nodes(
                    caps.moments,
                    rows,
                    one.root,
                    leaves,
                    stacks,
                    at_stack,
                    handed,
                    box.centre,
                    radius,
                    tolerance,
                    mode,
                    _LISTED,
                ),
            )
            undone = open_box(
                field, caps, rows, here, mesh, start, size, again, box.centre, box.half, tolerance, scale, one.root,
                leaves, one.first, one.count, one.depth, stacks, at_stack, places, at_places, slab, values,
            )  # fmt: skip
            fetch_add(counts, STRIDE * level + LOOKED, wp.where(again, count_bits(some), 1))
            if not again and undone != 0:
                place = fetch_add(counts, STRIDE * (level + 1) + OF_LISTED, 1)
                left[place] = ((mesh * cells[0] + child[0]) * cells[1] + child[1]) * cells[2] + child[2]
                left_octants[place] = undone
            some = some & (some - 1)
            if again:
                some = int(0)
        item = fetch_add_once(counts, STRIDE * level + NEXT, 1, 0)


@wp.func
def open_box(
    field: Field,
    caps: Caps,
    rows: wp.array(dtype=wp.float32),
    here: Slab,
    mesh: int,
    start: wp.vec3i,
    size: int,
    last: bool,
    centre: wp.vec3,
    half: wp.vec3,
    tolerance: float,
    scale: float,
    base: int,
    leaves: int,
    first: int,
    count: int,
    depth: int,
    stacks: wp.array(dtype=wp.int32),
    at_stack: int,
    places: wp.array(dtype=wp.float32),
    at_places: int,
    slab: Slab,
    values: wp.array4d(dtype=wp.float32),
):
    """Open the voxels of a box of 2^size along each edge by its field and the nodes that are listed for it; the octants
    that hold others, a bit for each.

    As `settled_boxes.settle_box` does.
    """
    change = most_change(field, half)
    far = field.near == 0 and largest_share(field, change) < LARGEST_SHARE
    undone = int(0)
    if far and not last:
        return undone
    error = doubt(field)
    if not far and not error < MOST_DOUBT:
        return 255
    middle = float(field.value) / FULL
    plain = far or (field.near == 0 and is_sure(middle - wp.floor(middle), 1.0, error + change))
    if size == 2 and not far:
        some = octants_left(values, mesh, start, slab.shape - start)
        if some != 0 and not plain:
            write_voxels(here, start, scale, places, at_places)
            if field.near > 0:
                nodes_of_box(
                    caps.moments, rows, base, leaves, caps.tree.corners, first, count, depth, stacks, at_stack,
                    field.near, some, tolerance, places, at_places,
                )  # fmt: skip
        if some != 0:
            undone = settle_voxels(
                field, slab, values, mesh, start, places, at_places, centre, plain, field.near > 0, -1.0, change
            )
        return undone & (OCTANTS - 1)
    for eighth in range(1 << (3 * (size - 1))):
        corner = start + 2 * place_in_box(eighth, size - 1)
        some = int(0)
        for k in range(8):
            if is_left(slab, values, mesh, corner + place_in_box(k, 1)):
                some = some | (1 << k)
        found = Sixteen()
        xs = Eight()
        ys = Eight()
        zs = Eight()
        if some != 0 and not plain:
            box = box_of_voxels(here, corner, 2, scale)
            for k in range(8):
                v = corner + place_in_box(k, 1)
                p = scale * voxel(here, v[0], v[1], v[2])
                xs[k] = p[0]
                ys[k] = p[1]
                zs[k] = p[2]
            if field.near > 0:
                found = angles_of_nodes(
                    caps.moments, rows, base, leaves, caps.tree.corners, first, count, depth, stacks, at_stack,
                    field.near, box.centre, wp.sqrt(box.half2), tolerance, xs, ys, zs,
                )  # fmt: skip
        while some != 0:
            k = bit_at(some, 0)
            some = some & (some - 1)
            v = corner + place_in_box(k, 1)
            whole = values[mesh, v[0], v[1], v[2]]
            winding = whole
            wrong = error + change
            if not far:
                share = middle
                if not plain:
                    share = share_at(field, wp.vec3(xs[k], ys[k], zs[k]) - centre) + found[k] / FULL
                    wrong = error + found[8 + k] / FULL
                winding = whole - share
            if far or is_sure(winding, whole, wrong):
                values[mesh, v[0], v[1], v[2]] = opened(winding)
            else:
                undone = undone | (1 << wp.where(size > 1, eighth, k))
    return undone


@wp.kernel
def _open_exactly_by_eights(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    caps: Caps,
    slab: Slab,
    cells: wp.vec3i,
    level: int,
    pieces: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    values: wp.array4d(dtype=wp.float32),
):
    """Open what is still left of boxes of 2^3 in float64."""
    item = fetch_add_once(counts, STRIDE * level + NEXT, 1, 0)
    while item < 8 * counts[STRIDE * LISTED_LEVEL + OF_LISTED]:
        mesh, v = voxel_of_piece(pieces[item / 8], item, cells)
        if is_left(slab, values, mesh, v):
            p = place_of_voxel(tree, slab, mesh, v)
            crossings = without_caps(tree, caps, mesh, p, values[mesh, v[0], v[1], v[2]])
            values[mesh, v[0], v[1], v[2]] = crossings + float(exact_share(boundary, tree, mesh, p))
            fetch_add(counts, EXACT, 1)
        item = fetch_add_once(counts, STRIDE * level + NEXT, 1, 0)


# The largest boxes that are looked at so, in bits. Where tolerances are small, nodes added to voxels would be many.
LARGEST = 2
MODES = MIXED, TO_VOXELS, TO_VOXELS
SMALL_TOLERANCES = 1.5e-4, 2e-5, 3e-6
LAST = BITS.index(0)


def open_caps_by_eights(
    tree: Tree, boundary: Boundary, caps: Caps, slab: Slab, values: wp.array, empty: Callable[[int, Any], wp.array]
) -> wp.array:
    """`open_caps.open_caps` on a CPU; the same counts."""
    device = values.device
    meshes, *shape = values.shape
    # Stacks of what is looked at by eights are large.
    workers, few = 16 * threads(), 4 * threads()
    counts = empty(COUNTS, wp.int32)
    counts.zero_()
    large, stacks = empty(workers * LARGE_STACK_ON_CPU, wp.int32), empty(few * STACK, wp.int32)
    places = empty(few * PLACES, wp.float32)
    nodes = caps.moments.size // MOMENTS_SIZE
    rows = empty(nodes * ROW, wp.float32)
    launch(pack_nodes, nodes, [caps.moments, rows], device)
    boxes = octants = left = left_octants = empty(1, wp.int32)
    cells = parents = wp.vec3i()
    first = first_level(meshes, shape, MOST_FIRST["cpu"])
    for level in range(first, LAST + 1):
        bits = BITS[level]
        parents, cells = (wp.vec3i(*(-(-n >> size) for n in shape)) for size in (bits + 1, bits))
        if bits > 0:
            boxes, octants = left, left_octants
            left, left_octants = (empty(meshes * cells[0] * cells[1] * cells[2], wp.int32) for _ in range(2))
        if bits > LARGEST:
            limits = [TOLERANCES["cpu"][level] * FULL, LISTED["cpu"][level], SETTLED["cpu"][level]]
            inputs = [caps, slab, bits, *limits, parents, cells, level, int(level == first)]
            inputs += [boxes, octants, left, left_octants, counts, large, values]
            launch(open_large_boxes, workers, inputs, device, smallest=1)
            continue
        listed = [left, left_octants] if bits == 0 else [boxes, octants]
        back = level - LAST - 1
        inputs = [
            caps,
            rows,
            slab,
            bits,
            SMALL_TOLERANCES[back] * FULL,
            MODES[back],
            parents,
            cells,
            level,
            int(level == first),
            *listed,
        ]
        launch(
            open_boxes_by_eights, few, [*inputs, left, left_octants, counts, stacks, places, values], device, smallest=1
        )
    inputs = [tree, boundary, caps, slab, parents, len(BITS), left, counts, values]
    launch(_open_exactly_by_eights, workers, inputs, device, smallest=1)
    return counts
