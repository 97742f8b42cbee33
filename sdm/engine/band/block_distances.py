"""Distances of the voxels of a narrow band's blocks, without a dense map, and the blocks that are kept."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import warp as wp
from jaxtyping import Float32, Int32
from torch import Tensor

from sdm.core.block_lookup import BLOCK
from sdm.engine.band.band_slab import BandSlab
from sdm.engine.band.listed_blocks import Listed, Room
from sdm.kernels.band.block_bits import AMBIGUOUS, BLOCKS, CHUNKS, COUNTS, KEPT, LOST, REGIONS, RUNS
from sdm.kernels.band.block_lists import gather_blocks, keep_near, list_inside_gaps
from sdm.kernels.band.block_winding import whole_windings
from sdm.kernels.band.open_blocks import open_blocks
from sdm.kernels.band.query import query_blocks
from sdm.kernels.dense.block.winners import BlockOutput
from sdm.kernels.dense.query import Surface
from sdm.kernels.launch import set_array
from sdm.runtime.graphs.branches import Join, kernels_beside
from sdm.runtime.host_copy import numbers_of
from sdm.runtime.torch_warp import as_warp, workspace

# Branch of a graph on which blocks are listed, and winding numbers found at their voxels.
LISTS = 1
# Blocks that are copied, with room for all of a list, before it is known how many are kept.
MOST_EARLY = 1 << 16


class Measured(NamedTuple):
    """Distances of listed blocks, and which of these are kept: numbers are in the list's counts.

    Args:
        values: (N,8,8,8) of all.
        kept: (N,) places of those with a voxel in the band, in their order, as many as there are.
        runs: (2*N,4) runs of blocks between these that are inside, in their order; empty if nobody asked.
    """

    values: Float32[Tensor, "n 8 8 8"]
    kept: Int32[Tensor, " n"]
    runs: Int32[Tensor, "m 4"]


class BandBlocks(NamedTuple):
    """The blocks of a band.

    Args:
        blocks: (N,3) their places, sorted.
        values: (N,8,8,8) clamped distances.
        ambiguous: Voxels with an unclear winding number.
        runs: (R,4) runs of others that are inside a closed mesh, sorted; None if nobody asked.
        beyond: Whether the mesh reaches beyond the grid, if it was given.
        room: What was needed; None if there was more than one list, or none.
    """

    blocks: Int32[Tensor, "n 3"]
    values: Float32[Tensor, "n 8 8 8"]
    ambiguous: int
    runs: Int32[Tensor, "r 4"] | None
    beyond: bool = False
    room: Room | None = None


def queue_measure(
    band: BandSlab, listed: Listed, *, gaps: bool, chunks: int | None = None, join_surface: Join | None = None
) -> Measured:
    """Measure the listed blocks, without a wait, and list those that are kept.

    To be called on the current stream.

    Args:
        band: What is asked.
        listed: The blocks that may have a voxel in the band, with or without room behind them.
        gaps: Whether to list the runs of blocks that are inside: the mesh is closed, and has its sign.
        chunks: See `query_blocks`.
        join_surface: The same.
    """
    structure, device, room = band.structure, band.structure.device, len(listed.blocks)
    tree, winding, frames, features, cones = structure.view
    empty = workspace(device)
    values = torch.empty((room, BLOCK, BLOCK, BLOCK), dtype=torch.float32, device=device)
    beside = band.shape[1] * band.shape[2] if band.signed and band.beyond else 0
    flat, counts = as_warp(values.view(-1), wp.float32), as_warp(listed.counts, wp.int32)
    blocks, lost = (as_warp(listed.counts[number : number + 1], wp.int32) for number in (BLOCKS, LOST))
    # Lists are made meanwhile.
    with kernels_beside(values, LISTS) as join_winding:
        # Few launches: the host takes most of a small band's time.
        near, layer = torch.zeros(room + beside, dtype=torch.int32, device=device).split([room, beside])
        if band.signed:
            order, ends = as_warp(listed.order, wp.int32), as_warp(layer, wp.int32)
            whole_windings(tree, winding, band.slab, listed.table, order, blocks, ends, flat, lost)
            if winding.caps.tree.count > 0:
                open_blocks(tree, winding.boundary, winding.caps, band.slab, listed.table, flat, empty)
        else:
            flat.zero_()
    to: Any = BlockOutput()
    to.table, to.width, to.shifts = listed.table, band.width, wp.vec3i(*band.shifts)
    set_array(to, "values", flat)
    set_array(to, "near", as_warp(near, wp.int32))
    surface, regions = Surface(tree, frames, features, cones), as_warp(listed.regions, wp.vec4i)
    query_blocks(
        surface,
        band.slab,
        band.measured_slab,
        to,
        regions,
        counts,
        band.plan,
        empty,
        chunks,
        join_surface,
        join_winding,
    )
    kept = torch.empty(room, dtype=torch.int32, device=device)
    places = as_warp(kept, wp.int32)
    keep_near(to.near, empty(room, wp.int32), places, counts)
    runs = kept.new_empty((2 * room if gaps else 0, 4))
    if gaps:
        places_of, gone = as_warp(listed.blocks, wp.vec3i), as_warp(runs, wp.vec4i)
        list_inside_gaps(places_of, places, flat, band.along[2], empty(2 * room, wp.int32), gone, counts)
    return Measured(values, kept, runs)


class Layers(NamedTuple):
    """Voxels of the layers that a band is of, the first of them, and the band's width: see `BandSlab`."""

    shape: tuple[int, int, int]
    first: int
    width: float


class Gathered(NamedTuple):
    """Blocks that are kept, in memory of their own, with or without room behind them: see `BandBlocks`."""

    blocks: Int32[Tensor, "n 3"]
    values: Float32[Tensor, "n 8 8 8"]
    runs: Int32[Tensor, "r 4"]


def queue_gather(
    layers: Layers, blocks: Int32[Tensor, "n 3"], measured: Measured, counts: Int32[Tensor, " c"], kept: int, runs: int
) -> Gathered:
    """Copies of the blocks that are kept and of the runs, without a wait.

    To be called on the current stream.

    Args:
        layers: What was asked.
        blocks: All that were listed.
        measured: What was measured of them.
        counts: The list's.
        kept: How many blocks there is room for in the copy.
        runs: The same, at most twice as many.
    """
    device = blocks.device
    found = Gathered(
        torch.empty((kept, 3), dtype=torch.int32, device=device),
        torch.empty((kept, BLOCK, BLOCK, BLOCK), dtype=torch.float32, device=device),
        torch.empty((runs, 4), dtype=torch.int32, device=device),
    )
    gather_blocks(
        as_warp(blocks, wp.vec3i),
        layers.shape,
        layers.first // BLOCK,
        layers.width,
        as_warp(measured.kept, wp.int32),
        as_warp(measured.values.view(-1), wp.float32),
        as_warp(measured.runs, wp.vec4i),
        as_warp(counts, wp.int32),
        as_warp(found.blocks, wp.vec3i),
        as_warp(found.values.view(-1), wp.float32),
        as_warp(found.runs, wp.vec4i),
    )
    return found


def gather_early(
    layers: Layers, blocks: Int32[Tensor, "n 3"], measured: Measured, counts: Int32[Tensor, " c"]
) -> Gathered | None:
    """`queue_gather` with room for all blocks that were listed, before it is known how many are kept; None if many.

    The device then has something to do while the host reads the numbers.
    """
    if len(blocks) > MOST_EARLY:
        return None
    return queue_gather(layers, blocks, measured, counts, len(blocks), len(measured.runs))


def taken(
    layers: Layers,
    blocks: Int32[Tensor, "n 3"],
    measured: Measured,
    counts: Int32[Tensor, " c"],
    said: list[int],
    early: Gathered | None,
) -> BandBlocks:
    """The blocks that are kept, in memory of their own.

    To be called on the current stream.

    Args:
        layers: What was asked.
        blocks: All that were listed, with or without room behind them.
        measured: What was measured of them.
        counts: The list's.
        said: These as numbers.
        early: What `gather_early` gave.
    """
    found = early or queue_gather(layers, blocks, measured, counts, said[KEPT], said[RUNS])
    kept = found.blocks[: said[KEPT]], found.values[: said[KEPT]]
    needed = Room(said[BLOCKS], said[REGIONS], said[CHUNKS])
    return BandBlocks(*kept, said[AMBIGUOUS], found.runs[: said[RUNS]], room=needed)


def measured_slab(band: BandSlab, listed: Listed, *, gaps: bool) -> BandBlocks:
    """The blocks that are kept of those listed, without room: waits for the device once.

    To be called on the current stream.
    """
    if len(listed.blocks):
        measured = queue_measure(band, listed, gaps=gaps)
        layers, counts = Layers(band.shape, band.layers[0], band.width), listed.counts[:COUNTS]
        wait = numbers_of(counts)
        early = gather_early(layers, listed.blocks, measured, counts)
        found = taken(layers, listed.blocks, measured, counts, wait(), early)
    else:
        values = torch.empty((0, BLOCK, BLOCK, BLOCK), dtype=torch.float32, device=band.structure.device)
        found = BandBlocks(listed.blocks, values, 0, listed.blocks.new_empty((0, 4)))
    return found._replace(runs=found.runs if gaps else None, beyond=band.beyond)
