"""Blocks of a narrow band and their distances, in as many slabs of the grid as it takes."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Int32, Int64
from torch import Tensor

from sdm.core.block_lookup import BLOCK, blocks_along
from sdm.core.grid import Grid
from sdm.engine.acceleration import AccelerationStructure
from sdm.engine.band.block_distances import refuse_too_many, slab_blocks
from sdm.engine.band.near_blocks import keys_near
from sdm.engine.ops import slab_view
from sdm.errors import GridError
from sdm.runtime.torch_warp import on_current_stream

# Of one slab, as voxels are counted with 32 bits.
MOST_BLOCKS = (1 << 22) - 1
# Slabs begin at multiples of so many blocks: a GPU's regions have 32 voxels along an edge.
SLAB_BLOCKS = 4
# More than the spacing along x, at which a crossing is from the voxel that it is marked at.
STEP_ROOM = 1.01


def measured_blocks(
    structure: AccelerationStructure, grid: Grid, width: float, *, signed: bool, beyond: bool
) -> tuple[Int32[Tensor, "n 3"], Tensor, int]:
    """Blocks (N,3) with a voxel nearer than `width`, their clamped values (N,8,8,8), and how many are ambiguous.

    Args:
        structure: Of one mesh.
        grid: The voxels.
        width: In the mesh's unit.
        signed: False for distances of at least 0.
        beyond: Whether triangles may be beyond the grid's last voxels along x.

    Raises:
        GridError: They do not fit into memory, or there are very many in one slab of the grid.
    """
    device = structure.device
    direction = (*grid.direction[0], *grid.direction[1], *grid.direction[2])
    slab = slab_view(grid.origin, grid.spacing, grid.shape, 0, direction)
    with on_current_stream(structure.memory[0], structure.memory[0]):
        tree, winding = structure.view[:2]
        keys = keys_near(tree, slab, grid, width, device)
        if signed and winding.caps.tree.count > 0 and not winding.caps.are_faces:
            caps = keys_near(winding.caps.tree, slab, grid, STEP_ROOM * grid.spacing[0], device)
            keys = torch.unique(torch.cat([keys, caps]))
    refuse_too_many(len(keys), device)
    if len(keys) <= MOST_BLOCKS:
        return slab_blocks(structure, grid, width, keys, (0, grid.shape[0]), signed=signed, beyond=beyond)
    parts = []
    for layers, theirs in slabs_of_blocks(keys, grid):
        # What is beyond a slab's last voxels is in the next.
        more = beyond or layers[1] < grid.shape[0]
        parts.append(slab_blocks(structure, grid, width, theirs, layers, signed=signed, beyond=more))
    blocks, values, ambiguous = zip(*parts, strict=True)
    return torch.cat(blocks), torch.cat(values), sum(ambiguous)


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
