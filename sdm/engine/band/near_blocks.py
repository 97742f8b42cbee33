"""Blocks of voxels near a surface: found from large boxes down to blocks of 8^3, or triangle by triangle."""

from __future__ import annotations

import math
from typing import Any

import torch
import warp as wp
from jaxtyping import Int32, Int64
from torch import Tensor

from sdm.core.block_lookup import BLOCK, blocks_along, blocks_of, keys_of
from sdm.core.device import SHARE_UNASKED, free_memory
from sdm.core.grid import Grid
from sdm.errors import GridError
from sdm.kernels.band.block_lists import pack_keys
from sdm.kernels.band.near_triangles import MOST_LARGE, mark_triangles
from sdm.kernels.band.surface_boxes import LENGTH, STRIDE, find_boxes, mark_boxes
from sdm.kernels.dense.plan import memory_of
from sdm.kernels.geometry.block_table import BITS
from sdm.runtime.torch_warp import as_warp, warp_name

# The largest boxes are so large that there are no more of them. A GPU looks at many in the time that a list takes.
MOST_FIRST = {"cpu": 512, "cuda": 1 << 15}
# Boxes that there is room for where lengths of lists are not read in between.
MOST_BOXES = 1 << 20
LISTED = (0, 0, 0)
# Of a block's values.
BLOCK_BYTES = 4 * BLOCK**3
# Bytes that are always there; asking takes time.
SMALL = 1 << 26
# Devices where each triangle marks its blocks, if the grid is not turned. On a CPU descents of the tree take less.
BY_TRIANGLES = ("cuda",)


def levels_of(shape: tuple[int, int, int], device: torch.device) -> list[int]:
    """Boxes of 2^this voxels that are tried, from large ones to blocks."""
    top = BITS
    while math.prod(_boxes_of(shape, top + 1)) > MOST_FIRST[device.type]:
        top += 1
    return list(range(top, BITS - 1, -1))


def rooms_of(shape: tuple[int, int, int], device: torch.device) -> list[int]:
    """Boxes that `mark_near` has room for at each level but the last."""
    return [min(math.prod(_boxes_of(shape, size)), MOST_BOXES) for size in levels_of(shape, device)[:-1]]


def marks_by_triangles(slab: Any, device: torch.device) -> bool:
    """True if `mark_near` looks at the triangles alone, and not at the boxes of their tree."""
    return device.type in BY_TRIANGLES and slab.turned == 0


def mark_near(
    tree: Any, slab: Any, shape: tuple[int, int, int], reach: float, bits: Any, counts: Int32[Tensor, " c"]
) -> None:
    """Set the bits of the blocks of a slab with a voxel that may be within `reach` of a mesh's triangles.

    To be called on the current stream. Waits for nothing.

    Args:
        tree: Of the mesh.
        slab: The voxels.
        shape: How many along each axis.
        reach: In the mesh's unit.
        bits: See `sdm.kernels.band.block_bits`.
        counts: Zeros, two for each level and for what is before the first: see `surface_boxes`. Where more boxes were
            counted than `rooms_of` says, bits are missing. Where triangles mark blocks, the first counts large ones.
    """
    if marks_by_triangles(slab, counts.device):
        large = torch.empty(MOST_LARGE, dtype=torch.int32, device=counts.device)
        mark_triangles(tree, slab, reach, bits, as_warp(large, wp.int32), as_warp(counts, wp.int32))
        return
    device, levels = counts.device, levels_of(shape, counts.device)
    # Kept until all is queued.
    lists: list[Tensor] = []
    known, numbers = _boxes_of(shape, levels[0] + 1), as_warp(counts, wp.int32)
    parents = as_warp(counts[:0].view(0, 3), wp.vec3i)
    for level, room in enumerate(rooms_of(shape, device)):
        lists.append(torch.empty((room, 3), dtype=torch.int32, device=device))
        found = as_warp(lists[-1], wp.vec3i)
        find_boxes(tree, slab, reach, levels[level], level, known, parents, found, numbers)
        known, parents = LISTED, found
    mark_boxes(tree, slab, reach, len(levels) - 1, known, parents, bits, numbers)


def keys_near(tree: Any, slab: Any, grid: Grid, reach: float, device: torch.device) -> Int64[Tensor, " n"]:
    """Keys, ascending, of the blocks of a grid with a voxel that may be within `reach` of a mesh's triangles.

    For any number of them: to be called on the current stream; waits for a GPU at each level.

    Raises:
        GridError: A level has more boxes than there is memory for blocks.
    """
    levels = levels_of(grid.shape, device)
    counts = torch.zeros((len(levels) + 1, STRIDE), dtype=torch.int32, device=device)
    known, boxes = _boxes_of(grid.shape, levels[0] + 1), counts.new_empty((0, 3))
    for level, size in enumerate(levels):
        room = 8 * (math.prod(known) or len(boxes))
        found = torch.empty((room, 3), dtype=torch.int32, device=device)
        lists = as_warp(boxes, wp.vec3i), as_warp(found, wp.vec3i)
        find_boxes(tree, slab, reach, size, level, known, *lists, as_warp(counts.view(-1), wp.int32))
        boxes, known = found[: int(counts[level + 1, LENGTH])], LISTED
        # Of a surface there are more of them at each level than at the one before.
        refuse_too_many(len(boxes), device, or_more=size > levels[-1])
    return sorted_keys(boxes, blocks_along(grid.shape))


def refuse_too_many(blocks: int, device: torch.device, *, or_more: bool = False) -> None:
    """Refuse a band that does not fit, before it is measured.

    Raises:
        GridError: More blocks than there is memory for.
    """
    # What is measured, and what is kept of it.
    needed, advice = 2 * BLOCK_BYTES * blocks, "choose larger voxels, or a smaller half_width"
    small = (memory_of(warp_name(device)) or 0) // SHARE_UNASKED
    if needed > max(SMALL, small) and needed > (free := free_memory(device)):
        count = f"{blocks:,} blocks{' or more' if or_more else ''}"
        raise GridError(
            f"a narrow band of {count} needs {needed / 2**30:.1f} GiB, but {device} has "
            f"{free / 2**30:.1f} GiB free: {advice}"
        )


def sorted_keys(boxes: Int32[Tensor, "n 3"], count: tuple[int, int, int]) -> Int64[Tensor, " n"]:
    """Keys of blocks in any order, ascending. To be called on the current stream."""
    keys = torch.empty(len(boxes), dtype=torch.int64, device=boxes.device)
    pack_keys(as_warp(boxes.view(-1), wp.int32), 3, count, as_warp(keys, wp.int64))
    return keys.sort().values


def _boxes_of(shape: tuple[int, int, int], bits: int) -> tuple[int, int, int]:
    return -(-shape[0] >> bits), -(-shape[1] >> bits), -(-shape[2] >> bits)


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
