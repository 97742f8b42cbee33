"""Opens the caps again: winding numbers near an open mesh's holes, from crossings that count its caps as closed.

Blocks of 32^3 voxels are tested first, in those the cells of 8^3, in those the bricks of 4^3 (see `caps`). The bricks
that may see a hole are listed; a group of lanes takes a piece of 2^3 at a time, tests it as well, and works it out
voxel by voxel: on a GPU eight side by side, four lanes to the caps of each.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.boundary import Boundary, boundary_winding
from sdm.kernels.caps import caps_are_far, count_caps, doubt, see_caps, share_of_turn
from sdm.kernels.grid import Slab, unravel, voxel
from sdm.kernels.lanes import GPU_LANES, fetch_add, sum_of_four
from sdm.kernels.launch import threads
from sdm.kernels.lists import BRICK, CELL, is_within, make_cell, octant
from sdm.kernels.tree import FRAME_SIZE, SCALE, Tree

wp.set_module_options({"enable_backward": False})

_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
CELLS_OF_BLOCK = wp.constant(4)
# Voxels along the edge of what a group opens at a time.
PIECE = wp.constant(2)
# Lanes that share a voxel's caps on a GPU.
SHARE = 4
# Groups of lanes at most, so that their threads can be counted; each takes more than one item then.
MOST_GROUPS = 1 << 20
# Groups that open bricks: 16 for each of an H100's multiprocessors.
GPU_WORKERS = 132 * 16
# What float32 adds to a share's error when all is summed up.
LAST_ROUNDINGS = wp.constant(2.0e-6)


@wp.struct
class Near:
    """What may see a hole."""

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
        cell = make_cell(slab, size * at, size, float(tree.frame[mesh * _FRAME_SIZE + _SCALE]))
        near.block[item] = wp.where(caps_are_far(boundary, mesh, cell, thread % lanes, lanes), 0, 1)
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
            scale = float(tree.frame[mesh * _FRAME_SIZE + _SCALE])
            if not caps_are_far(boundary, mesh, make_cell(slab, CELL * at, CELL, scale), lane, lanes):
                part = int(0)
                while part < 8:
                    start = CELL * at + BRICK * octant(part)
                    if is_within(slab, start):
                        far = caps_are_far(boundary, mesh, make_cell(slab, start, BRICK, scale), lane, lanes)
                        if lane == 0 and not far:
                            near.bricks[fetch_add(near.count, 0, 1)] = 8 * item + part
                    part = part + 1
        item = item + groups


@wp.func
def is_sure(winding: float, error: float):
    """Whether a winding number is on a known side of the values that decide about sign and clearness."""
    return wp.abs(winding - 0.25) > error and wp.abs(winding - 0.5) > error and wp.abs(winding - 0.75) > error


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
        start = CELL * at + BRICK * octant(brick) + PIECE * octant(group)
        scale = tree.frame[mesh * _FRAME_SIZE + _SCALE]
        number = int(8)
        if is_within(slab, start):
            if not caps_are_far(boundary, mesh, make_cell(slab, start, PIECE, float(scale)), lane, lanes):
                number = lane / share
        while number < 8:
            v = start + octant(number)
            point = voxel(slab, v[0], v[1], v[2])
            sight = see_caps(boundary, mesh, float(scale) * point, lane % share, share)
            error = sum_of_four(doubt(sight)) + LAST_ROUNDINGS
            whole = sum_of_four(float(sight.turns))
            part = sum_of_four(share_of_turn(sight))
            if lane % share == 0 and is_within(slab, v):
                closed = values[mesh, v[0], v[1], v[2]]
                winding = (closed - whole) - part
                if not is_sure(winding, error):
                    p = scale * wp.vec3d(point)
                    winding = closed - float(count_caps(boundary, tree, mesh, p))
                    winding = winding + float(boundary_winding(boundary, tree, mesh, p))
                values[mesh, v[0], v[1], v[2]] = winding
            number = number + lanes / share
        item = item + groups / 8


def open_caps(
    tree: Tree, boundary: Boundary, slab: Slab, values: wp.array, launch: Any, empty: Callable[[int, Any], wp.array]
) -> None:
    """From the winding numbers of surface and caps to the surface's own, where it matters for sign or clearness.

    Changes `values` (meshes, n, ny, nz) float32. `empty(length, dtype)` allocates scratch.
    """
    device = values.device
    meshes, *shape = values.shape
    lanes, share, workers = (GPU_LANES, SHARE, GPU_WORKERS) if device.is_cuda else (1, 1, 128 * threads())
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
