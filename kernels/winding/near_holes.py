"""Opens the caps again: winding numbers near an open mesh's holes, from crossings that count its caps as closed.

Blocks of 32^3 voxels are tested first, in those the cells of 8^3, in those the bricks of 4^3 (see `hole_caps`). The
bricks that may see a hole are listed; a group of lanes takes a piece of 2^3 at a time, tests it as well, and works it
out voxel by voxel: on a GPU eight side by side, four lanes to the caps of each.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree
from sdm.kernels.geometry.voxel_box import box_of_voxels, is_within, octant_at
from sdm.kernels.geometry.voxel_grid import Slab, unravel, voxel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import (
    GPU_BLOCKS,
    GPU_LANES,
    ballot,
    first_member,
    gpu_workers,
    sum_of_four,
    sum_of_lanes,
    sum_of_lanes_in_double,
)
from sdm.kernels.winding.boundary_term import Boundary, boundary_part
from sdm.kernels.winding.hole_caps import count_caps, doubt, is_far, is_sure, see_caps, share_of_turn, view_caps

wp.set_module_options({"enable_backward": False})

CELLS_OF_BLOCK = 4
# Voxels along the edge of a cell, and of a brick.
CELL, BRICK = 8, 4
# Voxels along the edge of what a group opens at a time.
PIECE = 2
# Lanes that share a voxel's caps on a GPU.
SHARE = 4
# Groups of lanes at most, so that their threads can be counted; each takes more than one item then.
MOST_GROUPS = 1 << 20


@wp.struct
class Near:
    """Blocks and bricks of voxels that may see a hole."""

    cells: wp.vec3i  # cells of 8^3 along each axis
    blocks: wp.vec3i  # blocks of 32^3 along each axis
    block: wp.array(dtype=wp.int32)  # 1 for each block that may see a hole
    bricks: wp.array(dtype=wp.int32)  # the bricks that may, in any order: 8 * cell + octant
    count: wp.array(dtype=wp.int32)  # (1) how many


@wp.kernel
def _find_near_blocks(begin: int, tree: Tree, boundary: Boundary, slab: Slab, near: Near, groups: int, lanes: int):
    thread = begin + wp.tid()
    item = thread / lanes
    total = near.block.shape[0]
    while item < total:
        mesh, at = unravel(item, near.blocks)
        size = CELLS_OF_BLOCK * CELL
        cell = box_of_voxels(slab, size * at, size, float(tree.frame[mesh * FRAME_SIZE + SCALE]))
        near.block[item] = wp.where(is_far(view_caps(boundary, mesh, cell, thread % lanes, lanes)), 0, 1)
        item = item + groups


@wp.kernel
def _find_near_bricks(
    begin: int, tree: Tree, boundary: Boundary, slab: Slab, near: Near, total: int, groups: int, lanes: int
):
    thread = begin + wp.tid()
    lane = thread % lanes
    item = thread / lanes
    while item < total:
        mesh, at = unravel(item, near.cells)
        above = at / CELLS_OF_BLOCK
        block = ((mesh * near.blocks[0] + above[0]) * near.blocks[1] + above[1]) * near.blocks[2] + above[2]
        if near.block[block] != 0:
            scale = float(tree.frame[mesh * FRAME_SIZE + SCALE])
            if not is_far(view_caps(boundary, mesh, box_of_voxels(slab, CELL * at, CELL, scale), lane, lanes)):
                octant = int(0)
                while octant < 8:
                    start = CELL * at + BRICK * octant_at(octant)
                    if is_within(slab, start):
                        view = view_caps(boundary, mesh, box_of_voxels(slab, start, BRICK, scale), lane, lanes)
                        if lane == 0 and not is_far(view):
                            near.bricks[fetch_add(near.count, 0, 1)] = 8 * item + octant
                    octant = octant + 1
        item = item + groups


@wp.func
def open_piece(
    boundary: Boundary,
    slab: Slab,
    mesh: int,
    start: wp.vec3i,
    scale: float,
    lane: int,
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open a piece as a whole, if that leaves no voxel in doubt; whether it did."""
    view = view_caps(boundary, mesh, box_of_voxels(slab, start, PIECE, scale), lane, lanes)
    if is_far(view):
        return True
    unsure = bool(False)
    number = lane
    while number < 8:
        v = start + octant_at(number)
        if is_within(slab, v):
            unsure = unsure or not is_sure(values[mesh, v[0], v[1], v[2]] - view.share, view.error)
        number = number + lanes
    if ballot(unsure) != wp.uint32(0):
        return False
    number = lane
    while number < 8:
        v = start + octant_at(number)
        if is_within(slab, v):
            values[mesh, v[0], v[1], v[2]] = values[mesh, v[0], v[1], v[2]] - view.share
        number = number + lanes
    return True


@wp.func
def open_voxel(
    tree: Tree,
    boundary: Boundary,
    slab: Slab,
    mesh: int,
    v: wp.vec3i,
    lane: int,
    lanes: int,
    values: wp.array4d(dtype=wp.float32),
):
    """Open a single voxel in float64."""
    p = tree.frame[mesh * FRAME_SIZE + SCALE] * wp.vec3d(voxel(slab, v[0], v[1], v[2]))
    closed = sum_of_lanes(float(count_caps(boundary, tree, mesh, p, lane, lanes)))
    share = sum_of_lanes_in_double(boundary_part(boundary, tree, mesh, p, lane, lanes))
    if lane == 0:
        values[mesh, v[0], v[1], v[2]] = values[mesh, v[0], v[1], v[2]] - closed + float(share)


@wp.kernel
def _open_bricks(
    begin: int,
    tree: Tree,
    boundary: Boundary,
    slab: Slab,
    near: Near,
    groups: int,
    lanes: int,
    share: int,
    values: wp.array4d(dtype=wp.float32),
):
    thread = begin + wp.tid()
    lane = thread % lanes
    group = thread / lanes
    item = group / 8
    total = near.count[0]
    while item < total:
        brick = near.bricks[item]
        mesh, at = unravel(brick / 8, near.cells)
        start = CELL * at + BRICK * octant_at(brick) + PIECE * octant_at(group)
        scale = tree.frame[mesh * FRAME_SIZE + SCALE]
        number = int(8)
        if is_within(slab, start):
            if not open_piece(boundary, slab, mesh, start, float(scale), lane, lanes, values):
                number = lane / share
        while number < 8:
            v = start + octant_at(number)
            point = voxel(slab, v[0], v[1], v[2])
            sight = see_caps(boundary, mesh, float(scale) * point, lane % share, share)
            error = sum_of_four(doubt(sight))
            whole = sum_of_four(float(sight.turns))
            part = sum_of_four(share_of_turn(sight))
            unsure = bool(False)
            if lane % share == 0 and is_within(slab, v):
                winding = (values[mesh, v[0], v[1], v[2]] - whole) - part
                unsure = not is_sure(winding, error)
                if not unsure:
                    values[mesh, v[0], v[1], v[2]] = winding
            # All lanes together, as a single one would take very long.
            left = ballot(unsure)
            while left != wp.uint32(0):
                other = first_member(left)
                left = left & (left - wp.uint32(1))
                v = start + octant_at(number - lane / share + other / share)
                open_voxel(tree, boundary, slab, mesh, v, lane, lanes, values)
            number = number + lanes / share
        item = item + groups / 8


def open_caps(
    tree: Tree, boundary: Boundary, slab: Slab, values: wp.array, empty: Callable[[int, Any], wp.array]
) -> None:
    """From the winding numbers of surface and caps to the surface's own, where it matters for sign or clearness.

    Changes `values` (meshes, n, ny, nz) float32. `empty(length, dtype)` allocates scratch.
    """
    device = values.device
    meshes, *shape = values.shape
    lanes, share, workers = 1, 1, 128 * threads()
    if device.is_cuda:
        lanes, share, workers = GPU_LANES, SHARE, gpu_workers(device, GPU_BLOCKS)
    near = Near()
    cells = [-(-n // int(CELL)) for n in shape]
    blocks = [-(-n // int(CELLS_OF_BLOCK)) for n in cells]
    near.cells, near.blocks = wp.vec3i(*cells), wp.vec3i(*blocks)
    total = meshes * cells[0] * cells[1] * cells[2]
    count = meshes * blocks[0] * blocks[1] * blocks[2]
    near.block = empty(count, wp.int32)
    near.bricks = empty(8 * total, wp.int32)
    near.count = empty(1, wp.int32)
    near.count.zero_()
    groups = min(count, MOST_GROUPS)
    launch(_find_near_blocks, groups * lanes, [tree, boundary, slab, near, groups, lanes], device, smallest=8)
    groups = min(total, MOST_GROUPS)
    launch(_find_near_bricks, groups * lanes, [tree, boundary, slab, near, total, groups, lanes], device, smallest=8)
    inputs = [tree, boundary, slab, near, workers, lanes, share, values]
    launch(_open_bricks, workers * lanes, inputs, device, smallest=1)
