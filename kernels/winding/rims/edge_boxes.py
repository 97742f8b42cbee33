"""Winding numbers of a mesh with few boundary edges, by the edges alone: without caps or a tree.

The winding number is the crossings of the surface plus the boundary's share (`boundary_term`). A box of voxels gets the
share at its centre, by the sum over all edges, polynomials of the edges that are far for its size, and a list of those
that are near, which are added for each voxel (`radial_strips`). What is left in doubt gets the sum over all edges
(`doubtful_voxels`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.voxel_box import box_of_voxels
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel, voxel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add, fetch_add_once
from sdm.kernels.primitives.lanes import (
    BLOCKS_PER_SM,
    GPU_LANES,
    bits_of_lanes,
    gpu_workers,
    on_cpu,
    sum_of_lanes,
    wait_for_lanes,
)
from sdm.kernels.primitives.shared_stacks import LARGE_STACK, LARGE_STACK_ON_CPU, large_stack_of
from sdm.kernels.winding.boundary_term import Boundary, edges_of
from sdm.kernels.winding.cap_field import Field, doubt, most_change, share_at
from sdm.kernels.winding.cap_tree import Caps
from sdm.kernels.winding.eight_voxels import place_in_box
from sdm.kernels.winding.looks.count_places import ALONE, BITS, COUNTS, EXACT, LENGTH, LOOKED, NEXT, STRIDE
from sdm.kernels.winding.near_caps import FULL, UNIT
from sdm.kernels.winding.rims.doubtful_voxels import open_doubtful
from sdm.kernels.winding.rims.radial_strips import (
    ACROSS_BOX,
    CUBES,
    DRIFT,
    ERROR,
    NEAR,
    PRODUCTS,
    SHARE,
    SHARE_ERROR,
    SLOPE,
    SQUARES,
    STEPS,
    VOXELS,
    Eight,
    Look,
    look_at_edges,
    strips_at,
)
from sdm.kernels.winding.settled_boxes import MOST_DOUBT, is_left, is_sure, opened

wp.set_module_options({"enable_backward": False})

# Room in a stack for the edges that are near, and behind them for those whose strips lie across a box.
ROOM = {"cuda": 1152, "cpu": 3072}
_ROOM_ON_GPU, _ROOM_ON_CPU = ROOM["cuda"], ROOM["cpu"]
_TOGETHER_ON_GPU, _TOGETHER_ON_CPU = VOXELS["cuda"], VOXELS["cpu"]
# Where in a box the way to its voxels begins, in half-widths: in its middle, but not on any plane that a mesh may have.
ASIDE = wp.constant(wp.vec3(2.7e-3, -3.1e-3, 1.9e-3))
WIDER = 1.004


@wp.func
def field_of(look: Look, lanes: int):
    """The field that all lanes have found together: that of the boundary's share, without what is near."""
    field = Field()
    field.value = wp.float64(FULL * sum_of_lanes(look[SHARE]))
    for axis in range(3):
        field.slope[axis] = sum_of_lanes(look[SLOPE + axis])
        field.squares[axis] = sum_of_lanes(look[SQUARES + axis])
        field.products[axis] = sum_of_lanes(look[PRODUCTS + axis])
    for number in range(7):
        field.cubes[number] = sum_of_lanes(look[CUBES + number])
    # Sums of so many numbers in a row, and of lanes.
    field.drift = sum_of_lanes(look[DRIFT])
    steps = sum_of_lanes(look[STEPS])
    field.error = sum_of_lanes(look[ERROR]) + 4.0 * UNIT * (steps + 14.0) * field.drift
    error = sum_of_lanes(look[SHARE_ERROR]) + 8.0 * UNIT * (1.0 + wp.abs(float(field.value)))
    field.error = field.error + FULL * error
    return field


@wp.kernel(launch_bounds=(128, BLOCKS_PER_SM))
def _open_by_edges(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    slab: Slab,
    bits: int,
    tolerance: float,
    cells: wp.vec3i,
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
    """Open boxes of 2^bits voxels along each edge, `cells` along each axis; list those that leave some in doubt.

    `next_item`, `looked` and `length` are places of the counts.
    """
    thread = begin + wp.tid()
    lane = thread % lanes
    stack = large_stack_of(stacks, thread / lanes)
    total = values.shape[0] * cells[0] * cells[1] * cells[2]
    room = wp.where(on_cpu(), _ROOM_ON_CPU, _ROOM_ON_GPU)
    room_across = wp.where(on_cpu(), LARGE_STACK_ON_CPU - _ROOM_ON_CPU, LARGE_STACK - _ROOM_ON_GPU)
    together = wp.where(on_cpu(), _TOGETHER_ON_CPU, _TOGETHER_ON_GPU)
    item = fetch_add_once(counts, next_item, 1, lane)
    while item < total:
        mesh, at = unravel(item, cells)
        scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
        here = slab_of(slab, mesh)
        start = wp.vec3i(at[0] << bits, at[1] << bits, at[2] << bits)
        box = box_of_voxels(here, start, 1 << bits, scale)
        c = box.centre + wp.cw_mul(ASIDE, box.half)
        half = WIDER * box.half
        radius = wp.length(half)
        look = look_at_edges(
            boundary.ends, mesh * boundary.count, edges_of(boundary), c, radius, half, tolerance, stack, 0, room, room,
            room_across, lane, lanes,
        )  # fmt: skip
        field = field_of(look, lanes)
        near = int(look[NEAR])
        across = int(look[ACROSS_BOX])
        wait_for_lanes()
        undone = int(0)
        change = most_change(field, half)
        error = doubt(field)
        middle = float(field.value) / FULL
        plain = near + across == 0 and is_sure(middle - wp.floor(middle), 1.0, error + change)
        if near > room or across > room_across or not error < MOST_DOUBT:
            undone = int(255)
        else:
            first = int(0)
            while first < 1 << (3 * bits):
                xs = Eight()
                ys = Eight()
                zs = Eight()
                for k in range(8):
                    number = first + wp.where(on_cpu(), k, k * lanes + lane)
                    if k < together and number < 1 << (3 * bits):
                        v = start + place_in_box(number, bits)
                        p = scale * voxel(here, v[0], v[1], v[2])
                        xs[k] = p[0]
                        ys[k] = p[1]
                        zs[k] = p[2]
                found = strips_at(boundary.ends, stack, 0, near, room, across, c, radius, xs, ys, zs)
                for k in range(8):
                    number = first + wp.where(on_cpu(), k, k * lanes + lane)
                    if k < together and number < 1 << (3 * bits):
                        v = start + place_in_box(number, bits)
                        if is_left(slab, values, mesh, v):
                            whole = values[mesh, v[0], v[1], v[2]]
                            share = middle
                            wrong = error + change
                            if not plain:
                                share = share_at(field, wp.vec3(xs[k], ys[k], zs[k]) - c) + found[k]
                                wrong = error + found[8 + k]
                            if is_sure(whole + share, whole, wrong):
                                values[mesh, v[0], v[1], v[2]] = opened(whole + share)
                            else:
                                inner = place_in_box(number, bits)
                                h = bits - 1
                                undone = undone | (1 << (4 * (inner[0] >> h) + 2 * (inner[1] >> h) + (inner[2] >> h)))
                first = first + together * lanes
        undone = bits_of_lanes(undone)
        if lane == 0:
            fetch_add(counts, looked, 1)
            if undone != 0:
                place = fetch_add(counts, length, 1)
                left[place] = item
                left_octants[place] = undone
        # All have read the lists before others take their place.
        wait_for_lanes()
        item = fetch_add_once(counts, next_item, 1, lane)


# A mesh with no more boundary edges than this, and for each from so many to that many faces, is opened by them: loose
# sheets and open boxes, whose caps are as large as they are, and so near for most boxes. Others are opened by caps.
MOST_EDGES = {"cuda": 2000, "cpu": 2000}
FACES_AN_EDGE = {"cuda": (0.5, 5), "cpu": (0.5, 6)}
# What an edge's polynomial may leave out of the solid angle.
TOLERANCES = {"cuda": 3e-3, "cpu": 6e-3}
# Bits of the size of boxes, smaller ones where a GPU has less than so many for each group of lanes.
BOX_BITS = {"cuda": 3, "cpu": 2}
FEWEST = 4


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
    kind = "cuda" if device.is_cuda else "cpu"
    counts = empty(COUNTS, wp.int32)
    counts.zero_()
    stacks = empty(1 if device.is_cuda else workers * LARGE_STACK_ON_CPU, wp.int32)
    bits = BOX_BITS[kind]
    if device.is_cuda and values.size >> (3 * bits) < FEWEST * workers:
        bits -= 1
    level = BITS.index(bits)
    cells = wp.vec3i(*(-(-n >> bits) for n in shape))
    left, left_octants = (empty(meshes * cells[0] * cells[1] * cells[2], wp.int32) for _ in range(2))
    at, after = STRIDE * level, STRIDE * (level + 1)
    inputs = [tree, boundary, slab, bits, TOLERANCES[kind], cells, left, left_octants]
    inputs += [at + NEXT, at + LOOKED, after + LENGTH, counts, stacks, lanes, values]
    launch(_open_by_edges, workers * lanes, inputs, device, smallest=1)
    inputs = [tree, boundary, caps, 1, slab, bits, cells, workers if device.is_cuda else 0, left, left_octants]
    inputs += [after + LENGTH, after + NEXT, STRIDE * ALONE + LOOKED, EXACT, counts, lanes, values]
    launch(open_doubtful, workers * lanes, inputs, device, smallest=1)
    return counts
