"""Blocks of voxels near a surface, found from large boxes down to blocks of 8^3."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
import warp as wp
from jaxtyping import Int32, Int64
from torch import Tensor

from sdm.core.block_lookup import BLOCK, blocks_along, blocks_of, keys_of
from sdm.core.grid import Grid
from sdm.kernels.band.block_lists import pack_keys
from sdm.kernels.band.surface_boxes import LENGTH, STRIDE, find_boxes
from sdm.kernels.geometry.block_table import BITS
from sdm.runtime.torch_warp import as_warp

# The largest boxes are so large that there are no more of them.
MOST_FIRST = 512
# On a GPU, where lengths of lists are read at the end alone, boxes and blocks that there is room for; with more, they
# are read one after the other.
MOST_BOXES, MOST_BLOCKS = 1 << 20, 1 << 22


def keys_near(tree: Any, slab: Any, grid: Grid, reach: float, device: torch.device) -> Int64[Tensor, " n"]:
    """Keys, ascending, of the blocks of a grid with a voxel that may be within `reach` of a mesh's triangles.

    To be called on the current stream. Waits for a GPU once, unless there are very many blocks.
    """
    top = BITS
    while math.prod(_boxes_of(grid, top + 1)) > MOST_FIRST:
        top += 1
    levels = range(top, BITS - 1, -1)
    # Counts and the first boxes, by one copy.
    begun = np.zeros((len(levels) + 1, STRIDE), np.int32)
    begun[0, LENGTH] = math.prod(_boxes_of(grid, top + 1))
    boxes_there = np.indices(_boxes_of(grid, top + 1), np.int32).reshape(3, -1).T
    both = torch.from_numpy(np.concatenate([begun.ravel(), boxes_there.ravel()])).to(device, non_blocking=True)
    counts, first = both[: begun.size].view(begun.shape), both[begun.size :].view(-1, 3)

    def look(level: int, bits: int, parents: Tensor, room: int) -> Tensor:
        boxes = torch.empty((room, 3), dtype=torch.int32, device=device)
        lists = as_warp(parents, wp.vec3i), as_warp(boxes, wp.vec3i)
        find_boxes(tree, slab, reach, bits, level, *lists, as_warp(counts.view(-1), wp.int32))
        return boxes

    if device.type != "cpu":
        boxes, rooms = first, [len(first)]
        for level, bits in enumerate(levels):
            most = MOST_BOXES if bits > BITS else MOST_BLOCKS
            rooms.append(min(math.prod(_boxes_of(grid, bits)), most))
            boxes = look(level, bits, boxes, rooms[-1])
        lengths = counts[:, LENGTH].tolist()
        if all(length <= room for length, room in zip(lengths, rooms, strict=True)):
            return sorted_keys(boxes[: lengths[-1]], blocks_along(grid.shape))
        counts[1:].zero_()
    boxes = first
    for level, bits in enumerate(levels):
        boxes = look(level, bits, boxes, 8 * len(boxes))[: int(counts[level + 1, LENGTH])]
    return sorted_keys(boxes, blocks_along(grid.shape))


def sorted_keys(boxes: Int32[Tensor, "n 3"], count: tuple[int, int, int]) -> Int64[Tensor, " n"]:
    """Keys of blocks in any order, ascending. To be called on the current stream."""
    keys = torch.empty(len(boxes), dtype=torch.int64, device=boxes.device)
    pack_keys(as_warp(boxes.view(-1), wp.int32), 3, count, as_warp(keys, wp.int64))
    return keys.sort().values


def _boxes_of(grid: Grid, bits: int) -> tuple[int, int, int]:
    nx, ny, nz = grid.shape
    return -(-nx >> bits), -(-ny >> bits), -(-nz >> bits)


def regions_with(
    blocks: Int32[Tensor, "n 3"], cell: int, shifts: tuple[int, int, int], count: tuple[int, int, int]
) -> Int32[Tensor, "r 4"]:
    """Regions (R,4) of 2^3 cells of a measured grid with voxels of some blocks: their places, and a bit for each cell.

    Args:
        blocks: Places of blocks of the wanted grid.
        cell: Voxels along the edge of a cell.
        shifts: Along each axis, the measured grid has 2^shift voxels from one of the wanted grid's to the next.
        count: Cells that the measured grid has along each axis.
    """
    cells = blocks.long()
    for axis, shift in enumerate(shifts):
        # Cells along this axis that have a voxel of a block's, from the one that has the first.
        voxels = torch.arange(BLOCK, device=blocks.device) << shift
        offsets = torch.unique(torch.div(voxels, cell, rounding_mode="floor"))
        first = torch.div((cells[:, axis] * BLOCK) << shift, cell, rounding_mode="floor")
        cells = cells.repeat_interleave(len(offsets), 0)
        cells[:, axis] = (first[:, None] + offsets).reshape(-1)
    cells = cells[(cells < torch.tensor(count, device=blocks.device)).all(1)]
    along = (-(-count[0] // 2), -(-count[1] // 2), -(-count[2] // 2))
    kept, place = torch.unique(keys_of(cells >> 1, along), return_inverse=True)
    x, y, z = (cells & 1).unbind(1)
    wanted = torch.zeros((len(kept), 8), dtype=torch.int32, device=blocks.device)
    wanted[place, 4 * x + 2 * y + z] = 1
    bits = (wanted << torch.arange(8, dtype=torch.int32, device=blocks.device)).sum(1, keepdim=True, dtype=torch.int32)
    return torch.cat([blocks_of(kept, along), bits], 1)
