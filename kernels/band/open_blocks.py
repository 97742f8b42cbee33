"""Opening of an open mesh's caps in the blocks of a band, from each block down to its voxels, see `winding.open_caps`.

A group of lanes takes a block through all levels, as few blocks are near a hole. Every voxel ends on the side of 0.25,
0.5 and 0.75 where the sum over all boundary edges is, and so with the sign that a dense map has.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import SCALE, Tree
from sdm.kernels.geometry.block_table import BITS as BLOCK_BITS
from sdm.kernels.geometry.block_table import BlockTable
from sdm.kernels.geometry.voxel_box import box_of_voxels, is_within, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, voxel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add_once
from sdm.kernels.primitives.lanes import BLOCKS_PER_SM, GPU_LANES, gpu_workers, on_cpu, unknown, wait_for_lanes
from sdm.kernels.primitives.shared_stacks import LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.boundary_term import Boundary
from sdm.kernels.winding.cap_descent import see_caps
from sdm.kernels.winding.cap_field import Field
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.looks.count_places import BITS
from sdm.kernels.winding.near_caps import FULL, NEAR_LIST
from sdm.kernels.winding.open_caps import FEW, LISTED, SETTLED, TOLERANCES
from sdm.kernels.winding.rims.single_voxels import open_voxel
from sdm.kernels.winding.settled_boxes import BlockWindings, is_left, put_winding, settle_box, winding_at

wp.set_module_options({"enable_backward": False})

# The levels of boxes from a block on: of 2^3, 2^2 and 2^1 voxels along an edge, and single ones twice.
FIRST_LEVEL = BITS.index(BLOCK_BITS)
LEVELS = len(BITS) - FIRST_LEVEL

Tolerances = wp.types.vector(length=LEVELS, dtype=wp.float32)
Limits = wp.types.vector(length=LEVELS, dtype=wp.int32)


@wp.struct
class CapLimits:
    """Tolerances of each level, and how many near caps there may be: see `open_caps`."""

    tolerances: Tolerances
    listed: Limits
    settled: Limits


@wp.func
def look_at_box(
    caps: Caps,
    limits: CapLimits,
    slab: Slab,
    start: wp.vec3i,
    bits: int,
    level: int,
    windings: BlockWindings,
    stack: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
):
    """Settle the voxels of a box of 2^bits; a bit for each octant with some that are left in doubt."""
    if not is_within(slab, start):
        return 0
    scale = float(caps.tree.frame[SCALE])
    box = box_of_voxels(slab, start, 1 << bits, scale)
    radius = wp.sqrt(box.half2)
    # Without Taylor polynomials where eight voxels are looked at at once.
    expand = not (on_cpu() and bits > 0 and bits < 3)
    few = wp.where(on_cpu() and bits == 1, FEW, 0)
    most, room = limits.tolerances[level], limits.listed[level]
    field = see_caps(
        caps, 0, box.centre, radius, most, room, Field(), -1, False, expand, few, stack, lane, lanes, lanes, False
    )
    octants = settle_box(
        field,
        caps,
        stack,
        slab,
        0,
        start,
        bits,
        bits == 0,
        limits.settled[level],
        box,
        scale,
        NEAR_LIST,
        lane,
        lanes,
        False,
        windings,
    )
    wait_for_lanes()
    return octants


@wp.kernel
def _open_blocks(
    begin: int,
    lanes: int,
    tree: Tree,
    boundary: Boundary,
    caps: Caps,
    limits: CapLimits,
    slab: Slab,
    table: BlockTable,
    next_block: wp.array(dtype=wp.int32),
    stacks: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = large_stack_of(stacks, thread / lanes)
    scale = tree.frame[SCALE]
    windings = BlockWindings()
    windings.values = values
    # Written out once, not eight times.
    eight = unknown(8)
    item = fetch_add_once(next_block, 0, 1, lane)
    while item < table.blocks.shape[0]:
        windings.place = item
        start = 8 * table.blocks[item]
        eighths = look_at_box(caps, limits, slab, start, 3, 0, windings, stack, lane, lanes)
        # All boxes of 2^1 voxels in the octants that are left.
        quarter = int(0)
        fours = int(0)
        while quarter < 64 and eighths != 0:
            if ((eighths >> (quarter >> 3)) & 1) == 0:
                quarter = quarter + 8
                fours = int(0)
            else:
                half = start + 4 * octant_at(quarter >> 3)
                if (quarter & 7) == 0:
                    fours = look_at_box(caps, limits, slab, half, 2, 1, windings, stack, lane, lanes)
                corner = half + 2 * octant_at(quarter)
                if ((fours >> (quarter & 7)) & 1) != 0:
                    twos = look_at_box(caps, limits, slab, corner, 1, 2, windings, stack, lane, lanes)
                    if twos != 0:
                        for o in range(eight):
                            v = corner + octant_at(o)
                            for level in range(3, LEVELS):
                                if is_left(slab, windings, 0, v):
                                    look_at_box(caps, limits, slab, v, 0, level, windings, stack, lane, lanes)
                            if is_left(slab, windings, 0, v):
                                p = scale * wp.vec3d(voxel(slab, v[0], v[1], v[2]))
                                whole = winding_at(windings, 0, v)
                                winding = open_voxel(tree, boundary, caps, 0, p, whole, lane, lanes)
                                # All lanes have read the whole number before it goes.
                                wait_for_lanes()
                                if lane == 0:
                                    put_winding(windings, 0, v, winding)
                            wait_for_lanes()
                quarter = quarter + 1
        item = fetch_add_once(next_block, 0, 1, lane)


def open_blocks(
    tree: Tree,
    boundary: Boundary,
    caps: Caps,
    slab: Slab,
    table: BlockTable,
    values: wp.array,
    empty: Callable[[int, Any], wp.array],
) -> None:
    """From the winding numbers of surface and caps at the voxels of blocks (N * 512) to the surface's own."""
    device: Any = values.device
    kind = "cuda" if device.is_cuda else "cpu"
    lanes, workers = (GPU_LANES, gpu_workers(device, BLOCKS_PER_SM)) if device.is_cuda else (1, 16 * threads())
    limits: Any = CapLimits()
    limits.tolerances = Tolerances(*(tolerance * float(FULL) for tolerance in TOLERANCES[kind][FIRST_LEVEL:]))
    limits.listed = Limits(*(int(n) for n in LISTED[kind][FIRST_LEVEL:]))
    limits.settled = Limits(*(int(n) for n in SETTLED[kind][FIRST_LEVEL:]))
    next_block = empty(1, wp.int32)
    next_block.zero_()
    stacks = empty(1 if device.is_cuda else workers * LARGE_STACK_ON_CPU, wp.int32)
    inputs = [lanes, tree, boundary, caps, limits, slab, table, next_block, stacks, values]
    launch(_open_blocks, workers * lanes, inputs, device, smallest=1)
