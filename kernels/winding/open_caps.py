"""Opening of an open mesh's caps: from the whole winding numbers of surface and caps to the surface's own.

What has to be right is on which side of 0.25, 0.5 and 0.75 the winding number of a voxel is: that is sign and
clearness. Boxes of 32^3 voxels are looked at first (`sdm.kernels.winding.cap_field`). Where the caps' share is less
than a quarter all over a box, its whole numbers will do; where the field's error leaves no voxel in doubt, the field's
values are taken; else its eighths are looked at, down to 2^3 voxels, then single voxels. What is in doubt even so gets
the sum over all boundary edges in float64, as `boundary_term` has it: so every voxel is on the side where that is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.block_table import VOXELS, inner_of
from sdm.kernels.geometry.voxel_box import VoxelBox, box_of_voxels, is_within, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, unravel, voxel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import (
    BLOCKS_PER_SM,
    GPU_LANES,
    bits_of_lanes,
    gpu_workers,
    sum_of_four,
    sum_of_lanes_in_double,
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

# Boxes of 2^5 voxels along each edge, and so on; single voxels twice.
BITS = (5, 4, 3, 2, 1, 0, 0)
# The first boxes are the smallest ones of which there are no more than this: a GPU has to be filled, and a launch costs
# more than looking at a box. Those of 2^3 are listed for what follows.
MOST_FIRST = {"cuda": 8192, "cpu": 16}
LISTED_BITS = 1
LISTED_LEVEL = BITS.index(LISTED_BITS) + 1
# What a node of the tree, or a cap, may add to the error of the winding number there; how many near caps there may be
# to look at one by one, and how many to add voxel by voxel.
TOLERANCES = {"cuda": (4e-3, 2e-3, 1e-3, 1e-4, 3e-5, 1e-5, 2e-6), "cpu": (4e-3, 2e-3, 1e-3, 6e-4, 1e-4, 1e-5, 2e-6)}
LISTED = (0, 0, 64, *4 * [MOST_NEAR])
SETTLED = {"cuda": (0, 0, 0, *4 * [MOST_NEAR]), "cpu": (0, 0, 12, *4 * [MOST_NEAR])}
# With a larger error the voxels are not looked at: too many would be in doubt.
MOST_DOUBT = 0.06
# Less than a quarter, by more than the rounding of the sums.
LARGEST_SHARE = 0.249
# What float32 adds to a winding number's error when all is summed up, and in proportion to the number.
LAST_ROUNDINGS, LAST_ROUNDING = 2.0e-6, 3.0e-7
# Places of the counts: for each level, and for the sums over all edges, which box is next, and how many there are; how
# many single voxels were looked at the first time and the second, and how many got the sum over all edges.
NEXT, LENGTH, STRIDE = 0, 1, 2
ALONE = STRIDE * (len(BITS) + 1)
EXACT, COUNTS = ALONE + 2, ALONE + 3


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


@wp.struct
class BlockWindings:
    """Winding numbers of blocks of 8^3 voxels, see `geometry.block_table`, of which one is looked at."""

    values: wp.array(dtype=wp.float32)  # (N * 512)
    place: wp.int32


@wp.func
def winding_at(values: wp.array4d(dtype=wp.float32), mesh: int, v: wp.vec3i):
    """The winding number of a voxel, of all or of one block's."""
    return values[mesh, v[0], v[1], v[2]]


@wp.func
def winding_at(values: BlockWindings, mesh: int, v: wp.vec3i):  # noqa: F811
    return values.values[VOXELS * values.place + inner_of(v)]


@wp.func
def put_winding(values: wp.array4d(dtype=wp.float32), mesh: int, v: wp.vec3i, winding: float):
    """Write it."""
    values[mesh, v[0], v[1], v[2]] = winding


@wp.func
def put_winding(values: BlockWindings, mesh: int, v: wp.vec3i, winding: float):  # noqa: F811
    values.values[VOXELS * values.place + inner_of(v)] = winding


@wp.func
def settle_box(
    field: Field,
    caps: Caps,
    stack: wp.array(dtype=wp.int32),
    slab: Slab,
    mesh: int,
    start: wp.vec3i,
    bits: int,
    most_near: int,
    box: VoxelBox,
    scale: float,
    lane: int,
    lanes: int,
    values: Any,
):
    """Open the voxels of a box that the field leaves in no doubt; the octants that hold others, a bit for each."""
    far = largest_share(field, box.half) < LARGEST_SHARE
    if far and bits > 0:
        return 0
    if field.near > most_near or doubt(field) > MOST_DOUBT:
        return 255
    # Lanes for each voxel: four of 2^3, all of a single one.
    share = wp.max(1, lanes >> (3 * bits))
    left = int(0)
    number = lane / share
    while number < 1 << (3 * bits):
        at = wp.vec3i(number >> (2 * bits), (number >> bits) & ((1 << bits) - 1), number & ((1 << bits) - 1))
        v = start + at
        whole = float(0.5)
        if is_within(slab, v):
            whole = winding_at(values, mesh, v)
        p = scale * voxel(slab, v[0], v[1], v[2])
        angle = float(0.0)
        wrong = float(0.0)
        if is_whole(whole):
            angle, wrong = near_angle(caps, mesh, field.near, p, stack, lane % share, share)
        if share == 4:
            # Also, all have read the whole number before it goes.
            angle = sum_of_four(angle)
            wrong = sum_of_four(wrong) + 2.0 * UNIT * FULL
        winding = whole
        if not far:
            winding = whole - angle / FULL - share_at(field, p - box.centre)
        if is_whole(whole):
            if far or is_sure(winding, whole, doubt(field) + wrong / FULL):
                if lane % share == 0:
                    put_winding(values, mesh, v, opened(winding))
            else:
                half = bits - 1
                left = left | (1 << (4 * (at[0] >> half) + 2 * (at[1] >> half) + (at[2] >> half)))
        number = number + lanes / share
    octants = bits_of_lanes(left)
    return octants


@wp.func
def voxel_of_piece(piece: int, octant: int, cells: wp.vec3i):
    """The mesh and the indices of a voxel of a box of 2^3, of which there are so many along each axis."""
    mesh, at = unravel(piece, cells)
    return mesh, 2 * at + octant_at(octant)


@wp.func
def is_left(slab: Slab, values: Any, mesh: int, v: wp.vec3i):
    """True if a voxel is there, and not open yet."""
    if not is_within(slab, v):
        return False
    return is_whole(winding_at(values, mesh, v))


@wp.kernel
def _open_boxes(
    begin: int,
    caps: Caps,
    slab: Slab,
    bits: int,
    tolerance: float,
    listed: int,
    settled: int,
    cells: wp.vec3i,
    eighths: wp.vec3i,
    level: int,
    first: int,
    boxes: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open boxes of 2^bits voxels along each edge; those that are left in doubt are listed by their eighths.

    Boxes of 2^3 are listed as they are, and what is looked at after them are their voxels that are left.
    """
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = stack_of(stacks, thread / lanes)
    total = values.shape[0] * cells[0] * cells[1] * cells[2]
    if first == 0:
        total = counts[STRIDE * level + LENGTH]
        if bits == 0:
            total = 8 * counts[STRIDE * LISTED_LEVEL + LENGTH]
    item = fetch_add_once(counts, STRIDE * level + NEXT, 1, lane)
    while item < total:
        number = item
        if bits == 0:
            number = boxes[item / 8]
        elif first == 0:
            number = boxes[item]
        mesh, at = unravel(number, cells)
        start = wp.vec3i(at[0] << bits, at[1] << bits, at[2] << bits)
        here = bool(True)
        if bits == 0:
            start = 2 * at + octant_at(item)
            here = is_left(slab, values, mesh, start)
        if here:
            scale = float(caps.tree.frame[mesh * FRAME_SIZE + SCALE])
            box = box_of_voxels(slab, start, 1 << bits, scale)
            field = see_caps(caps, mesh, box.centre, wp.sqrt(box.half2), tolerance, listed, stack, lane, lanes)
            octants = settle_box(field, caps, stack, slab, mesh, start, bits, settled, box, scale, lane, lanes, values)
            if bits > LISTED_BITS:
                octant = lane
                while octant < 8:
                    child = 2 * at + octant_at(octant)
                    half = bits - 1
                    corner = wp.vec3i(child[0] << half, child[1] << half, child[2] << half)
                    if ((octants >> octant) & 1) != 0 and is_within(slab, corner):
                        place = fetch_add(counts, STRIDE * (level + 1) + LENGTH, 1)
                        left[place] = ((mesh * eighths[0] + child[0]) * eighths[1] + child[1]) * eighths[2] + child[2]
                    octant = octant + lanes
            elif lane == 0:
                if bits == 0:
                    fetch_add(counts, ALONE + level - LISTED_LEVEL, 1)
                elif octants != 0:
                    left[fetch_add(counts, STRIDE * (level + 1) + LENGTH, 1)] = number
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
    if caps.are_faces != 0:
        return float(count_crossings(tree, mesh, p)) + float(share)
    return whole - float(count_crossings(caps.tree, mesh, p)) + float(share)


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
            p = tree.frame[mesh * FRAME_SIZE + SCALE] * wp.vec3d(voxel(slab, v[0], v[1], v[2]))
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
    kind = "cuda" if device.is_cuda else "cpu"
    boxes = left = empty(1, wp.int32)
    first = first_level(meshes, shape, MOST_FIRST[kind])
    pieces = wp.vec3i(*(-(-n // 2) for n in shape))
    for level in range(first, len(BITS)):
        bits = BITS[level]
        cells = pieces if bits == 0 else wp.vec3i(*(-(-n >> bits) for n in shape))
        eighths = cells
        if bits > LISTED_BITS:
            eighths = wp.vec3i(*(-(-n >> (bits - 1)) for n in shape))
        if bits > 0:
            boxes, left = left, empty(meshes * eighths[0] * eighths[1] * eighths[2], wp.int32)
        limits = [TOLERANCES[kind][level] * FULL, LISTED[level], SETTLED[kind][level]]
        listed = left if bits == 0 else boxes
        inputs = [caps, slab, bits, *limits, cells, eighths, level, int(level == first), listed, left]
        launch(_open_boxes, workers * lanes, [*inputs, counts, stacks, lanes, values], device, smallest=1)
    inputs = [tree, boundary, caps, slab, pieces, len(BITS), left, counts, lanes, values]
    launch(_open_exactly, workers * lanes, inputs, device, smallest=1)
    return counts
