"""Distances of the voxels of a narrow band's blocks, without a dense map: the fast path."""

from __future__ import annotations

import math
from typing import Any

import torch
import warp as wp
from jaxtyping import Int32, Int64
from torch import Tensor

from sdm.core.block_lookup import BLOCK, blocks_along
from sdm.core.device import free_memory
from sdm.core.grid import Grid
from sdm.engine.acceleration import AccelerationStructure, MeshKind
from sdm.engine.band.near_blocks import regions_with
from sdm.engine.gradients import IDENTITY
from sdm.engine.ops import slab_view
from sdm.engine.plan_override import OPTIONS
from sdm.engine.thick_slices import AS_IT_IS, Slices, Triple, finer, scales_of
from sdm.errors import GridError
from sdm.kernels.band.block_lists import gather_blocks, list_regions_of, unpack_keys
from sdm.kernels.band.block_winding import whole_windings
from sdm.kernels.band.open_blocks import open_blocks
from sdm.kernels.band.query import query_blocks
from sdm.kernels.dense.block.winners import BlockOutput
from sdm.kernels.dense.plan import Workload, make_plan, memory_of
from sdm.kernels.dense.query import Surface
from sdm.kernels.geometry.block_table import BlockTable
from sdm.kernels.launch import set_array
from sdm.runtime.torch_warp import as_warp, on_current_stream, workspace

BLOCK_BYTES = 4 * BLOCK**3
# Bytes that are always there; asking takes time.
SMALL = 1 << 26
# Rows of blocks that a table has all of.
MOST_ROWS = 1 << 20


def slab_blocks(
    structure: AccelerationStructure,
    whole: Grid,
    width: float,
    keys: Int64[Tensor, " k"],
    layers: tuple[int, int],
    *,
    signed: bool,
    beyond: bool,
) -> tuple[Int32[Tensor, "n 3"], Tensor, int]:
    """Blocks (N,3) of some layers of a grid with a voxel in the band, their values, and how many are ambiguous.

    Args:
        structure: Of one mesh.
        whole: The grid.
        width: In the mesh's unit.
        keys: Of the blocks of these layers that may have one, ascending, as `sdm.core.block_lookup` counts them.
        layers: The first, a multiple of the edge of any region of voxels, and the one after the last.
        signed: False for distances of at least 0.
        beyond: Whether triangles may be beyond the last of the layers.
    """
    device = structure.device
    direction = (*whole.direction[0], *whole.direction[1], *whole.direction[2])
    shape = (layers[1] - layers[0], whole.shape[1], whole.shape[2])
    grid = Slices(whole.spacing, shape, layers[0])
    if layers[0]:
        keys = keys - layers[0] // BLOCK * math.prod(blocks_along(shape)[1:])
    slab = slab_view(whole.origin, whole.spacing, shape, layers[0], direction)
    with on_current_stream(structure.memory[0], structure.memory[0]) as warp_device:
        tree, winding, frames, features, cones = structure.view
        along = blocks_along(shape)
        blocks = torch.empty((len(keys), 3), dtype=torch.int32, device=device)
        values = torch.empty((len(keys), BLOCK, BLOCK, BLOCK), dtype=torch.float32, device=device)
        if not len(keys):
            return blocks, values, 0
        lines = torch.empty_like(keys)
        unpack_keys(as_warp(keys, wp.int64), along, as_warp(blocks, wp.vec3i), as_warp(lines, wp.int64))
        table, rows = block_table(blocks, along, keys)
        # Few launches: the host takes most of a small band's time.
        beside = shape[1] * shape[2] if signed and beyond else 0
        zeros = torch.zeros(len(keys) + 3 + beside, dtype=torch.int32, device=device)
        near, ambiguous, lost, listed, layer = zeros.split([len(keys), 1, 1, 1, beside])
        flat, empty = values.view(-1), workspace(device)
        if signed:
            order = lines.argsort().int()
            whole_windings(
                tree,
                winding,
                slab,
                table,
                as_warp(order, wp.int32),
                as_warp(layer, wp.int32),
                as_warp(flat, wp.float32),
                as_warp(lost, wp.int32),
            )
            if winding.caps.tree.count > 0:
                open_blocks(tree, winding.boundary, winding.caps, slab, table, as_warp(flat, wp.float32), empty)
        else:
            values.zero_()
        times = _times(structure, grid)
        fine = _measured_slices(grid, times)
        work = Workload(structure.sizes.faces, tree.depth, 1, fine.shape, fine.spacing, direction != IDENTITY)
        plan = make_plan(work, memory_of(warp_device.alias), OPTIONS.get())
        shifts = (times[0].bit_length() - 1, times[1].bit_length() - 1, times[2].bit_length() - 1)
        count = tuple(-(-n // plan.cell) for n in fine.shape)
        if times == AS_IT_IS:
            regions = _regions_of(table, len(blocks), plan.cell, listed)
        else:
            regions = regions_with(blocks, plan.cell, shifts, (count[0], count[1], count[2]))
        to: Any = BlockOutput()
        to.table, to.width, to.shifts = table, width, wp.vec3i(*shifts)
        set_array(to, "values", as_warp(flat, wp.float32))
        set_array(to, "near", as_warp(near, wp.int32))
        query_blocks(
            Surface(tree, frames, features, cones),
            slab,
            slab_view(whole.origin, fine.spacing, fine.shape, fine.first, direction),
            to,
            as_warp(regions, wp.vec4i),
            as_warp(ambiguous, wp.int32),
            plan,
            empty,
        )
        kept = near.nonzero()[:, 0]
        kept_blocks = torch.empty((len(kept), 3), dtype=torch.int32, device=device)
        kept_values = torch.empty((len(kept), BLOCK, BLOCK, BLOCK), dtype=torch.float32, device=device)
        gather_blocks(
            table,
            shape,
            width,
            as_warp(kept, wp.int64),
            as_warp(flat, wp.float32),
            as_warp(kept_blocks, wp.vec3i),
            as_warp(kept_values.view(-1), wp.float32),
        )
        if layers[0]:
            kept_blocks[:, 0] += layers[0] // BLOCK
        del rows
    unclear = 0 if structure.kind is MeshKind.CLOSED or not signed else int(ambiguous)
    return kept_blocks, kept_values, unclear


def refuse_too_many(blocks: int, device: torch.device) -> None:
    """Refuse a band that does not fit, before it is measured.

    Raises:
        GridError: More blocks than there is memory for.
    """
    # What is measured, and what is kept of it.
    needed, advice = 2 * BLOCK_BYTES * blocks, "choose larger voxels, or a smaller half_width"
    if needed > SMALL and needed > (free := free_memory(device)):
        raise GridError(
            f"a narrow band of {blocks:,} blocks needs {needed / 2**30:.1f} GiB, but {device} has "
            f"{free / 2**30:.1f} GiB free: {advice}"
        )


def _regions_of(table: Any, blocks: int, cell: int, count: Int32[Tensor, " 1"]) -> Int32[Tensor, "r 4"]:
    """`regions_with` where the grid that is measured is that of the blocks; `count` is zero."""
    regions = torch.empty((blocks, 4), dtype=torch.int32, device=count.device)
    list_regions_of(table, (cell // BLOCK) - 1, as_warp(regions, wp.vec4i), as_warp(count, wp.int32))
    return regions[: int(count)]


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
    table: Any = BlockTable()
    set_array(table, "blocks", as_warp(blocks, wp.vec3i))
    set_array(table, "rows", as_warp(rows, wp.int32))
    table.low, table.size = wp.vec2i(*low), wp.vec2i(*size)
    return table, (blocks, rows)


def _times(structure: AccelerationStructure, slices: Slices) -> Triple:
    """Factors by which a dense map of these layers is measured with more slices."""
    options = OPTIONS.get()
    if structure.device.type != "cpu" or options.method == "search":
        return AS_IT_IS
    (scale,) = scales_of(structure.view.tree, 1)
    return finer(slices, scale, structure.sizes.faces, options.slice_factors)


def _measured_slices(wanted: Slices, times: Triple) -> Slices:
    """The layers that are measured, with `times` as many slices."""
    if times == AS_IT_IS:
        return wanted
    across = tuple(k * (n - 1) + 1 for k, n in zip(times[1:], wanted.shape[1:], strict=True))
    spacing = tuple(s / k for s, k in zip(wanted.spacing, times, strict=True))
    return Slices(spacing, (times[0] * wanted.shape[0], *across), times[0] * wanted.first)
