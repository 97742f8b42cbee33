"""Blocks of a narrow band and their distances, in as many slabs of the grid as it takes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
from jaxtyping import Int64
from torch import Tensor

from sdm.core.block_lookup import BLOCK, blocks_along
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.acceleration import AccelerationStructure
from sdm.engine.band.band_slab import BandSlab
from sdm.engine.band.block_distances import BandBlocks, measured_slab
from sdm.engine.band.inside_runs import gaps_inside
from sdm.engine.band.listed_blocks import (
    MOST_BLOCKS,
    STEP_ROOM,
    fits,
    has_bits,
    is_beyond,
    list_keys,
    narrowed,
    queue_list,
    reaches_beyond,
    room_for_all,
)
from sdm.engine.band.near_blocks import keys_near, refuse_too_many, rooms_of
from sdm.errors import GridError
from sdm.kernels.band.block_bits import BLOCKS
from sdm.runtime.torch_warp import on_current_stream

# Slabs begin at multiples of so many blocks: a GPU's regions have 32 voxels along an edge.
SLAB_BLOCKS = 4


def measured_blocks(
    structure: AccelerationStructure,
    grid: Grid,
    width: float,
    *,
    signed: bool,
    mesh: TriangleMesh | None = None,
    gaps: bool = False,
) -> BandBlocks:
    """Blocks with a voxel nearer than `width`, and their clamped values.

    Args:
        structure: Of one mesh.
        grid: The voxels.
        width: In the mesh's unit.
        signed: False for distances of at least 0.
        mesh: The mesh, where it matters whether it reaches beyond the grid.
        gaps: Whether to list the runs of blocks inside, next to these: of closed meshes with a sign.

    Raises:
        GridError: They do not fit into memory, or there are very many in one slab of the grid.
    """
    band = BandSlab(structure, grid, width, (0, grid.shape[0]), signed)
    if mesh is not None:
        mesh = TriangleMesh(mesh.vertices.detach().contiguous(), mesh.faces.contiguous(), mesh.name, check=False)
        band = replace(band, mesh=mesh)
    reads = structure.memory if mesh is None else (*structure.memory, mesh.vertices, mesh.faces)
    with on_current_stream(structure.memory[0], *reads):
        if has_bits(band):
            room = room_for_all(band)
            listed = queue_list(band, room)
            counts = listed.counts.tolist()
            refuse_too_many(counts[BLOCKS], structure.device)
            if fits(counts, room, rooms_of(band.shape, structure.device)) and counts[BLOCKS] <= MOST_BLOCKS:
                band = replace(band, beyond=mesh is not None and is_beyond(counts, grid))
                return measured_slab(band, narrowed(band, listed, counts), gaps=gaps)
        band = replace(band, beyond=mesh is not None and reaches_beyond(*mesh.bounds, grid))
        return _by_keys(band, gaps)


def _by_keys(band: BandSlab, gaps: bool) -> BandBlocks:
    """The same, for any number of blocks and any grid."""
    grid, structure, device = band.whole, band.structure, band.structure.device
    tree, winding = structure.view[:2]
    keys = keys_near(tree, band.slab, grid, band.width, device)
    if band.signed and winding.caps.tree.count > 0 and not winding.caps.are_faces:
        caps = keys_near(winding.caps.tree, band.slab, grid, STEP_ROOM * grid.spacing[0], device)
        keys = torch.unique(torch.cat([keys, caps]))
    refuse_too_many(len(keys), device)
    if len(keys) <= MOST_BLOCKS:
        return measured_slab(band, list_keys(band, keys), gaps=gaps)
    parts = []
    for layers, theirs in slabs_of_blocks(keys, grid):
        # What is beyond a slab's last voxels is in the next.
        slab = replace(band, layers=layers, beyond=band.beyond or layers[1] < grid.shape[0])
        before = layers[0] // BLOCK * math.prod(blocks_along(grid.shape)[1:])
        parts.append(measured_slab(slab, list_keys(slab, theirs - before), gaps=False))
    blocks, values = torch.cat([part.blocks for part in parts]), torch.cat([part.values for part in parts])
    runs = gaps_inside(blocks, values, blocks_along(grid.shape)[2]) if gaps else None
    return BandBlocks(blocks, values, sum(part.ambiguous for part in parts), runs, band.beyond)


def slabs_of_blocks(keys: Int64[Tensor, " n"], grid: Grid) -> Iterator[tuple[tuple[int, int], Int64[Tensor, " m"]]]:
    """Slabs of layers (first, last) of a grid with at most `MOST_BLOCKS` blocks each, and those blocks' keys.

    Raises:
        GridError: The thinnest slab has more blocks than that.
    """
    count = blocks_along(grid.shape)
    ends = torch.arange(SLAB_BLOCKS, count[0] + SLAB_BLOCKS, SLAB_BLOCKS, device=keys.device) * (count[1] * count[2])
    starts = [0, *torch.searchsorted(keys, ends).tolist()]
    begin = 0
    for number in range(1, len(starts)):
        is_last = number + 1 == len(starts)
        if is_last or starts[number + 1] - starts[begin] > MOST_BLOCKS:
            if starts[number] - starts[begin] > MOST_BLOCKS:
                raise GridError(
                    f"{SLAB_BLOCKS * BLOCK} layers of a narrow band have more than {MOST_BLOCKS:,} blocks: choose "
                    "larger voxels, or a smaller half_width"
                )
            first, last = SLAB_BLOCKS * BLOCK * begin, min(SLAB_BLOCKS * BLOCK * number, grid.shape[0])
            if starts[number] > starts[begin]:
                yield (first, last), keys[starts[begin] : starts[number]]
            begin = number
