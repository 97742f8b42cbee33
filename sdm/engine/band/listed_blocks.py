"""Lists of the blocks of some layers that may have a voxel in a band: without a sort, by the bits of the whole grid.

Where the grid has too many blocks for that, or there are more than one query takes, keys are sorted.
"""

from __future__ import annotations

import math
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import torch
import warp as wp
from jaxtyping import Int32, Int64
from torch import Tensor

from sdm.core.block_lookup import BLOCK
from sdm.core.grid import Grid
from sdm.engine.band.band_slab import BandSlab
from sdm.engine.band.near_blocks import levels_of, mark_near, regions_with
from sdm.engine.thick_slices import AS_IT_IS
from sdm.kernels.band.block_bits import BLOCKS, CHUNKS, COUNTS, REGIONS, block_bits, list_bits, words_of
from sdm.kernels.band.block_lists import unpack_keys
from sdm.kernels.band.surface_boxes import LENGTH, STRIDE
from sdm.kernels.bvh.build import reduce_bounds, reset_bounds
from sdm.kernels.geometry.block_table import BlockTable
from sdm.kernels.launch import set_array
from sdm.runtime.torch_warp import as_warp

# Of one query, as voxels are counted with 32 bits.
MOST_BLOCKS = (1 << 22) - 1
# Rows of blocks that a table has all of, and blocks of a grid that have a bit.
MOST_ROWS, MOST_BITS = 1 << 20, 1 << 28
# More than the spacing along x, at which a crossing is from the voxel that it is marked at.
STEP_ROOM = 1.01
# Numbers of a mesh's box.
BOUNDS = 6


class Room(NamedTuple):
    """Entries that there is room for."""

    blocks: int
    regions: int
    chunks: int | None = None  # of candidate lists, if it is known how many are needed


class Listed(NamedTuple):
    """Blocks of some layers, and what follows from them. In what there is room for, numbers are in `counts`.

    Args:
        blocks: (N,3), sorted by x, then y, then z.
        order: (N,) their places, sorted by y, then z, then x.
        rows: Where each row begins; `table` has both, as kernels take them.
        table: See above.
        regions: (R,4) regions of the measured grid, see `find_listed_witnesses`, in any order.
        counts: See `sdm.kernels.band.block_bits`, and after these numbers those of `mark_near` and, if a mesh was given
            with the layers, the bits of its lowest coordinates and of its highest ones with a minus.
    """

    blocks: Int32[Tensor, "n 3"]
    order: Int32[Tensor, " n"]
    rows: Int32[Tensor, " r"]
    table: Any
    regions: Int32[Tensor, "m 4"]
    counts: Int32[Tensor, " c"]


def has_bits(band: BandSlab) -> bool:
    """True if these layers have so few blocks that each has a bit."""
    x, y, z = band.along
    return math.prod(band.along) <= MOST_BITS and x * y <= MOST_ROWS and y * z <= MOST_ROWS


def room_for_all(band: BandSlab) -> Room:
    """As much as may be needed of layers that have bits."""
    blocks = min(math.prod(band.along), MOST_BLOCKS)
    if band.times != AS_IT_IS:
        return Room(blocks, 0)
    edge = 2 * band.plan.cell // BLOCK
    return Room(blocks, min(blocks, math.prod(-(-n // edge) for n in band.along)))


def queue_list(band: BandSlab, room: Room) -> Listed:
    """Blocks that may be near, without a wait: if there are more than there is room for, `fits` says so.

    To be called on the current stream.
    """
    device, along = band.structure.device, band.along
    size, rows = words_of(along)
    levels = STRIDE * (len(levels_of(band.shape, device)) + 1)
    zeros = torch.zeros(COUNTS + levels + BOUNDS + size, dtype=torch.int32, device=device)
    counts, words = zeros.split([COUNTS + levels + BOUNDS, size])
    numbers = counts[COUNTS : COUNTS + levels]
    bits = block_bits(along)
    set_array(bits, "words", as_warp(words, wp.int32))
    tree, winding = band.structure.view[:2]
    mark_near(tree, band.slab, band.shape, band.width, bits, numbers)
    if band.signed and winding.caps.tree.count > 0 and not winding.caps.are_faces:
        # What is counted of both is less than what there is room for, or some is left out.
        more = torch.zeros(levels, dtype=torch.int32, device=device)
        mark_near(winding.caps.tree, band.slab, band.shape, STEP_ROOM * band.whole.spacing[0], bits, more)
        torch.maximum(numbers, more, out=numbers)
    if band.mesh is not None:
        corners, faces = as_warp(band.mesh.vertices[None], wp.vec3), as_warp(band.mesh.faces, wp.int32)
        bounds = as_warp(counts[-BOUNDS:].view(torch.float32), wp.float32)
        reset_bounds(bounds)
        reduce_bounds(tree, corners, faces, bounds)
    ends = torch.empty(2 * rows, dtype=torch.int32, device=device)
    blocks = torch.empty((room.blocks, 3), dtype=torch.int32, device=device)
    order = torch.empty(room.blocks, dtype=torch.int32, device=device)
    begins = torch.empty(along[0] * along[1] + 1, dtype=torch.int32, device=device)
    regions = torch.empty((room.regions, 4), dtype=torch.int32, device=device)
    table = _table(blocks, begins, (0, 0), along[:2])
    # Of 2^3 cells of 4, 8 or 16 voxels.
    region_bits = band.plan.cell // BLOCK if band.times == AS_IT_IS else None
    list_bits(
        bits,
        as_warp(ends, wp.int32),
        table,
        as_warp(order, wp.int32),
        region_bits,
        as_warp(regions, wp.vec4i),
        as_warp(counts, wp.int32),
    )
    return Listed(blocks, order, begins, table, regions, counts)


def fits(counts: list[int], room: Room, boxes: list[int]) -> bool:
    """True if nothing is missing in what `queue_list` gave, of whose counts these are the numbers.

    `boxes`: see `near_blocks.rooms_of`.
    """
    lengths = counts[COUNTS + STRIDE + LENGTH :: STRIDE]
    there = all(length <= most for length, most in zip(lengths, boxes, strict=False))
    if room.chunks is not None and counts[CHUNKS] > room.chunks:
        # Nothing is missing, but voxels were searched one by one.
        return False
    return there and counts[BLOCKS] <= room.blocks and counts[REGIONS] <= room.regions


def is_beyond(counts: list[int], grid: Grid, *, minus: bool = True) -> bool:
    """True if the mesh of the layers, of whose lists these are the counts, reaches beyond their grid.

    `minus`: whether its highest coordinates have one.
    """
    bounds = np.array(counts[-BOUNDS:], np.int32).view(np.float32).astype(np.float64)
    return reaches_beyond(bounds[:3], -bounds[3:] if minus else bounds[3:], grid)


def reaches_beyond(low: np.ndarray, high: np.ndarray, grid: Grid) -> bool:
    """True if a corner of a mesh's box is outside the grid, so that rows far from its surface may be inside."""
    # By plain numbers: the device waits for this.
    origin, spacing, shape = grid.origin, grid.spacing, grid.shape
    if grid.is_axis_aligned:
        ends = zip(low.tolist(), high.tolist(), origin, spacing, shape, strict=True)
        return any((a - o) / s < 0 or (b - o) / s > n - 1 for a, b, o, s, n in ends)
    for corner in product(*zip(low.tolist(), high.tolist(), strict=True)):
        for axis in range(3):
            way = sum((c - o) * row[axis] for c, o, row in zip(corner, origin, grid.direction, strict=True))
            if not 0 <= way / spacing[axis] <= shape[axis] - 1:
                return True
    return False


def narrowed(band: BandSlab, listed: Listed, counts: list[int]) -> Listed:
    """The lists without room behind them, given the counts as numbers."""
    blocks, along = listed.blocks[: counts[BLOCKS]], band.along
    regions = listed.regions[: counts[REGIONS]]
    if band.times != AS_IT_IS:
        regions = _regions_with(band, blocks, listed.counts)
    table = _table(blocks, listed.rows, (0, 0), along[:2])
    return Listed(blocks, listed.order[: len(blocks)], listed.rows, table, regions, listed.counts)


def list_keys(band: BandSlab, keys: Int64[Tensor, " n"]) -> Listed:
    """The lists of blocks whose keys, ascending, are given, as `sdm.core.block_lookup` counts them in these layers.

    To be called on the current stream. Waits for the device.
    """
    device, along = band.structure.device, band.along
    blocks = torch.empty((len(keys), 3), dtype=torch.int32, device=device)
    lines = torch.empty_like(keys)
    unpack_keys(as_warp(keys, wp.int64), along, as_warp(blocks, wp.vec3i), as_warp(lines, wp.int64))
    table, (_, rows) = block_table(blocks, along, keys)
    counts = torch.zeros(COUNTS, dtype=torch.int32, device=device)
    counts[BLOCKS] = len(keys)
    regions = _regions_with(band, blocks, counts)
    return Listed(blocks, lines.argsort().int(), rows, table, regions, counts)


def _regions_with(band: BandSlab, blocks: Int32[Tensor, "n 3"], counts: Tensor) -> Int32[Tensor, "m 4"]:
    cell = band.plan.cell
    x, y, z = (-(-n // cell) for n in band.measured.shape)
    regions = regions_with(blocks, cell, band.shifts, (x, y, z))
    counts[REGIONS] = len(regions)
    return regions


def block_table(
    blocks: Int32[Tensor, "n 3"], count: tuple[int, int, int], keys: Int64[Tensor, " n"]
) -> tuple[Any, tuple[Tensor, ...]]:
    """The kernels' table of blocks that are sorted, of which these are the keys, and the memory that it is in."""
    low, size = [0, 0], list(count[:2])
    if count[0] * count[1] <= MOST_ROWS:
        begins = torch.arange(0, (size[0] * size[1] + 1) * count[2], count[2], device=blocks.device)
        rows = torch.searchsorted(keys, begins, out_int32=True)
    else:
        # Of those that there are alone; to know them is to wait for the device.
        low = blocks[:, :2].amin(0).tolist()
        size = [high + 1 - least for high, least in zip(blocks[:, :2].amax(0).tolist(), low, strict=True)]
        row = (blocks[:, 0].long() - low[0]) * size[1] + blocks[:, 1] - low[1]
        rows = torch.searchsorted(row, torch.arange(size[0] * size[1] + 1, device=blocks.device), out_int32=True)
    return _table(blocks, rows, (low[0], low[1]), (size[0], size[1])), (blocks, rows)


def _table(blocks: Tensor, rows: Tensor, low: tuple[int, int], size: tuple[int, int]) -> Any:
    table: Any = BlockTable()
    set_array(table, "blocks", as_warp(blocks, wp.vec3i))
    set_array(table, "rows", as_warp(rows, wp.int32))
    table.low, table.size = wp.vec2i(*low), wp.vec2i(*size)
    return table
