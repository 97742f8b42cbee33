"""Blocks of voxels near a surface, found from large boxes down to blocks of 8^3."""

from __future__ import annotations

from typing import Any

import torch
import warp as wp
from jaxtyping import Int32, Int64
from torch import Tensor

from sdm.core.block_lookup import BLOCK, blocks_along, blocks_of, keys_of
from sdm.core.grid import Grid
from sdm.kernels.band.surface_boxes import LENGTH, STRIDE, find_boxes
from sdm.kernels.geometry.block_table import BITS
from sdm.runtime.torch_warp import as_warp

# The largest boxes are so large that there are no more of them.
MOST_FIRST = 512


def keys_near(tree: Any, slab: Any, grid: Grid, reach: float, device: torch.device) -> Int64[Tensor, " n"]:
    """Keys, ascending, of the blocks of a grid with a voxel that may be within `reach` of a mesh's triangles.

    To be called on the current stream; waits for the device once for each size of boxes.
    """
    bits = BITS
    while _boxes_of(grid, bits + 1).prod() > MOST_FIRST:
        bits += 1
    parents = torch.cartesian_prod(
        *(torch.arange(int(n), dtype=torch.int32, device=device) for n in _boxes_of(grid, bits + 1))
    )
    counts = torch.zeros(2 * STRIDE, dtype=torch.int32, device=device)
    for level in range(bits, BITS - 1, -1):
        room = 8 * len(parents)
        boxes = torch.empty((room, 3), dtype=torch.int32, device=device)
        counts.zero_()
        counts[LENGTH] = len(parents)
        find_boxes(
            tree,
            slab,
            reach,
            level,
            0,
            as_warp(parents, wp.vec3i),
            as_warp(boxes, wp.vec3i),
            as_warp(counts, wp.int32),
            len(parents),
        )
        parents = boxes[: int(counts[STRIDE + LENGTH])]
        if not len(parents):
            break
    return keys_of(parents, blocks_along(grid.shape)).sort().values


def _boxes_of(grid: Grid, bits: int) -> Int64[Tensor, " 3"]:
    return torch.tensor([-(-n >> bits) for n in grid.shape], dtype=torch.int64, device="cpu")


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
