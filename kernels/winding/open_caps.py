"""Opening of an open mesh's caps: from the whole winding numbers of surface and caps to the surface's own.

What has to be right is on which side of 0.25, 0.5 and 0.75 the winding number of a voxel is: that is sign and
clearness. Boxes of 32^3 voxels are looked at first (`sdm.kernels.winding.cap_field`). Where the caps' share is less
than a quarter all over a box, its whole numbers will do; where the field's error leaves no voxel in doubt, the field's
values are taken; else its eighths are looked at, down to 2^3 voxels, then single voxels. What is in doubt even so gets
the sum over all boundary edges in float64, as `boundary_term` has it: so every voxel is on the side where that is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.voxel_box import VoxelBox, box_of_voxels, is_within, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, unravel, voxel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import (
    BLOCKS_PER_SM,
    GPU_LANES,
    ballot,
    bits_of_lanes,
    gpu_workers,
    members_of,
    sum_of_four,
    sum_of_lanes_in_double,
    unknown,
    wait_for_lanes,
)
from sdm.kernels.primitives.shared_stacks import STACK, stack_of
from sdm.kernels.winding.boundary_term import Boundary, boundary_part
from sdm.kernels.winding.cap_field import (
    FULL,
    MOST_NEAR,
    UNIT,
    Field,
    doubt,
    largest_share,
    near_angle,
    see_caps,
    share_at,
)
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.ray_crossings import count_crossings

wp.set_module_options({"enable_backward": False})

# Voxels along the edges of the boxes that are looked at one after the other, and what a node of the tree may add to the
# error of the winding number there.
SIZES = (32, 16, 8, 4)
TOLERANCES = (4e-3, 2e-3, 1e-3, 5e-4)
# How many near caps there may be to look at one by one, and how many to add voxel by voxel: a GPU has a lane for each
# voxel, a CPU tries the eighths first, which have fewer.
LISTED = {"cuda": (0, 0, 64, MOST_NEAR), "cpu": (0, 0, 64, MOST_NEAR)}
SETTLED = {"cuda": (0, 0, 2, MOST_NEAR), "cpu": (0, 0, 12, 24)}
# With a larger error the voxels are not looked at: too many would be in doubt.
MOST_DOUBT = 0.06
# The same for boxes of 2^3, if so many voxels are in doubt; for single voxels, and for those that are still in doubt.
PIECE, PIECE_TOLERANCE, FEWEST = 2, 2e-4, 3
POINT_TOLERANCE, FINER, LAST_TOLERANCE = 5e-5, 0.2, 1e-6
# Less than a quarter, by more than the rounding of the sums.
LARGEST_SHARE = 0.249
# What float32 adds to a winding number's error when all is summed up, and in proportion to the number.
LAST_ROUNDINGS, LAST_ROUNDING = 2.0e-6, 3.0e-7
# Places of the counts: for each size, and at last for 2^3, which box is next, and how many there are; then how many
# voxels got the field of a point, and the sum over all edges.
NEXT, LENGTH, STRIDE = 0, 1, 2
POINTS, EXACT = STRIDE * (len(SIZES) + 1), STRIDE * (len(SIZES) + 1) + 1
COUNTS = EXACT + 1


@wp.func
def is_sure(winding: float, whole: float, error: float):
    """True if a winding number is on a known side of the values that decide about sign and clearness."""
    off = wp.min(wp.abs(winding - 0.25), wp.min(wp.abs(winding - 0.5), wp.abs(winding - 0.75)))
    return off > error + LAST_ROUNDINGS + LAST_ROUNDING * wp.abs(whole)


@wp.func
def is_whole(winding: float):
    """True if a voxel still has the winding number of surface and caps."""
    return winding == wp.floor(winding)


@wp.func
def opened(winding: float):
    """A winding number as it is written: never a whole one, which would tell that the voxel is not open yet."""
    return wp.where(is_whole(winding), winding + 0.0625, winding)


@wp.func
def settle_box(
    field: Field,
    caps: Caps,
    stack: wp.array(dtype=wp.int32),
    slab: Slab,
    mesh: int,
    start: wp.vec3i,
    size: int,
    most_near: int,
    box: VoxelBox,
    scale: float,
    lane: int,
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open the voxels of a box that the field leaves in no doubt; the octants that hold others, a bit for each."""
    if largest_share(field, box.half) < LARGEST_SHARE:
        return 0
    if field.near > most_near or doubt(field) > MOST_DOUBT:
        return 255
    last = wp.min(wp.vec3i(size, size, size), slab.shape - start)
    count = last[0] * last[1] * last[2]
    half = size / 2
    left = int(0)
    number = lane
    while number < count:
        at = wp.vec3i(number / (last[1] * last[2]), number / last[2] % last[1], number % last[2])
        v = start + at
        whole = values[mesh, v[0], v[1], v[2]]
        if is_whole(whole):
            p = scale * voxel(slab, v[0], v[1], v[2])
            angle, wrong = near_angle(caps, mesh, field.near, p, stack, 0, 1)
            winding = whole - angle / FULL - share_at(field, p - box.centre)
            if is_sure(winding, whole, doubt(field) + wrong / FULL):
                values[mesh, v[0], v[1], v[2]] = opened(winding)
            else:
                left = left | (1 << (4 * (at[0] / half) + 2 * (at[1] / half) + at[2] / half))
        number = number + lanes
    octants = int(0)
    for octant in range(8):
        if ballot(((left >> octant) & 1) != 0) != wp.uint32(0):
            octants = octants | (1 << octant)
    return octants


@wp.kernel
def _open_boxes(
    begin: int,
    caps: Caps,
    slab: Slab,
    size: int,
    tolerance: float,
    listed: int,
    settled: int,
    cells: wp.vec3i,
    eighths: wp.vec3i,
    level: int,
    boxes: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open boxes of size^3 voxels; those that are left in doubt are listed by their eighths."""
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = stack_of(stacks, thread / lanes)
    total = values.shape[0] * cells[0] * cells[1] * cells[2]
    if level > 0:
        total = counts[STRIDE * level + LENGTH]
    item = fetch_add_once(counts, STRIDE * level + NEXT, 1, lane)
    while item < total:
        number = item
        if level > 0:
            number = boxes[item]
        mesh, at = unravel(number, cells)
        start = size * at
        scale = float(caps.tree.frame[mesh * FRAME_SIZE + SCALE])
        box = box_of_voxels(slab, start, size, scale)
        field = see_caps(caps, mesh, box.centre, wp.sqrt(box.half2), tolerance, listed, stack, lane, lanes)
        octants = settle_box(field, caps, stack, slab, mesh, start, size, settled, box, scale, lane, lanes, values)
        octant = lane
        while octant < 8:
            if ((octants >> octant) & 1) != 0:
                child = 2 * at + octant_at(octant)
                if is_within(slab, (size / 2) * child):
                    place = fetch_add(counts, STRIDE * (level + 1) + LENGTH, 1)
                    index = ((mesh * eighths[0] + child[0]) * eighths[1] + child[1]) * eighths[2] + child[2]
                    left[place] = index
            octant = octant + lanes
        item = fetch_add_once(counts, STRIDE * level + NEXT, 1, lane)


@wp.func
def open_voxel(
    tree: Tree,
    boundary: Boundary,
    caps: Caps,
    mesh: int,
    p: wp.vec3d,
    whole: float,
    lane: int,
    lanes: int,
):
    """The winding number at p (scaled) by the sum over all boundary edges, from that of surface and caps."""
    share = sum_of_lanes_in_double(boundary_part(boundary, tree, mesh, p, lane, lanes))
    return whole - float(count_crossings(caps.tree, mesh, p)) + float(share)


@wp.kernel
def _open_pieces(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    caps: Caps,
    slab: Slab,
    cells: wp.vec3i,
    level: int,
    pieces: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open boxes of 2^3 voxels, those that are left in doubt voxel by voxel."""
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = stack_of(stacks, thread / lanes)
    total = counts[STRIDE * level + LENGTH]
    item = fetch_add_once(counts, STRIDE * level + NEXT, 1, lane)
    while item < total:
        mesh, at = unravel(pieces[item], cells)
        start = PIECE * at
        scale = tree.frame[mesh * FRAME_SIZE + SCALE]
        mask = int(0)
        octant = lane
        while octant < 8:
            v = start + octant_at(octant)
            if is_within(slab, v):
                if is_whole(values[mesh, v[0], v[1], v[2]]):
                    mask = mask | (1 << octant)
            octant = octant + lanes
        mask = bits_of_lanes(mask)
        if members_of(mask) >= FEWEST:
            box = box_of_voxels(slab, start, PIECE, float(scale))
            tolerance = PIECE_TOLERANCE * FULL
            field = see_caps(caps, mesh, box.centre, wp.sqrt(box.half2), tolerance, MOST_NEAR, stack, lane, lanes)
            if largest_share(field, box.half) < LARGEST_SHARE:
                mask = int(0)
            elif doubt(field) <= MOST_DOUBT:
                octant = lane * 8 / lanes
                share = wp.max(lanes / 8, 1)
                left = int(0)
                while octant < 8:
                    angle = float(0.0)
                    wrong = float(0.0)
                    v = start + octant_at(octant)
                    p = float(scale) * voxel(slab, v[0], v[1], v[2])
                    if ((mask >> octant) & 1) != 0:
                        angle, wrong = near_angle(caps, mesh, field.near, p, stack, lane % share, share)
                    angle = sum_of_four(angle)
                    wrong = sum_of_four(wrong) + 2.0 * UNIT * FULL
                    if ((mask >> octant) & 1) != 0:
                        whole = values[mesh, v[0], v[1], v[2]]
                        winding = whole - angle / FULL - share_at(field, p - box.centre)
                        if is_sure(winding, whole, doubt(field) + wrong / FULL):
                            # All lanes have read the whole number before it goes: they sum up first.
                            if lane % share == 0:
                                values[mesh, v[0], v[1], v[2]] = opened(winding)
                        else:
                            left = left | (1 << octant)
                    octant = octant + wp.max(1, lanes / share)
                mask = bits_of_lanes(left)
            wait_for_lanes()
        for number in range(unknown(8)):
            if ((mask >> number) & 1) != 0:
                v = start + octant_at(number)
                point = float(scale) * voxel(slab, v[0], v[1], v[2])
                whole = values[mesh, v[0], v[1], v[2]]
                winding = whole
                error = float(wp.inf)
                tolerance = POINT_TOLERANCE * FULL
                while not is_sure(winding, whole, error) and tolerance > LAST_TOLERANCE * FULL:
                    here = see_caps(caps, mesh, point, 0.0, tolerance, 0, stack, lane, lanes)
                    winding = whole - share_at(here, wp.vec3())
                    error = doubt(here)
                    if lane == 0:
                        fetch_add(counts, POINTS, 1)
                    tolerance = FINER * tolerance
                if not is_sure(winding, whole, error):
                    exactly = scale * wp.vec3d(voxel(slab, v[0], v[1], v[2]))
                    winding = open_voxel(tree, boundary, caps, mesh, exactly, whole, lane, lanes)
                    if lane == 0:
                        fetch_add(counts, EXACT, 1)
                # All lanes have read the whole number before it goes.
                wait_for_lanes()
                if lane == 0:
                    values[mesh, v[0], v[1], v[2]] = winding
        item = fetch_add_once(counts, STRIDE * level + NEXT, 1, lane)


def open_caps(
    tree: Tree, boundary: Boundary, caps: Caps, slab: Slab, values: wp.array, empty: Callable[[int, Any], wp.array]
) -> wp.array:
    """From the winding numbers of surface and caps to the surface's own, where it matters for sign or clearness.

    Changes `values` (meshes, n, ny, nz) float32. `empty(length, dtype)` allocates scratch. Returns the counts, (COUNTS)
    int32.
    """
    device = values.device
    meshes, *shape = values.shape
    lanes, workers = 1, 16 * threads()
    if device.is_cuda:
        lanes, workers = GPU_LANES, gpu_workers(device, BLOCKS_PER_SM)
    counts = empty(COUNTS, wp.int32)
    counts.zero_()
    stacks = empty(1 if device.is_cuda else workers * STACK, wp.int32)
    boxes = empty(1, wp.int32)
    kind = "cuda" if device.is_cuda else "cpu"
    levels = zip(SIZES, TOLERANCES, LISTED[kind], SETTLED[kind], strict=True)
    for level, (size, tolerance, listed, settled) in enumerate(levels):
        cells, eighths = ([-(-n // edge) for n in shape] for edge in (size, size // 2))
        left = empty(meshes * eighths[0] * eighths[1] * eighths[2], wp.int32)
        grids = [wp.vec3i(*cells), wp.vec3i(*eighths)]
        inputs = [caps, slab, size, tolerance * FULL, listed, settled, *grids]
        inputs += [level, boxes, left, counts, stacks, lanes, values]
        launch(_open_boxes, workers * lanes, inputs, device, smallest=1)
        boxes = left
    inputs = [tree, boundary, caps, slab, grids[1], len(SIZES), boxes, counts, stacks, lanes, values]
    launch(_open_pieces, workers * lanes, inputs, device, smallest=1)
    return counts
