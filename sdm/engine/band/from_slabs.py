"""Narrow bands from dense slabs: the plain path, whose blocks and values the fast one has too."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from sdm.core.block_lookup import BLOCK, blocks_along
from sdm.core.grid import Grid
from sdm.engine.band.inside_runs import voxel_points

if TYPE_CHECKING:
    from sdm.engine.arguments import Sign
    from sdm.engine.mesh_index import MeshIndex

# Memory of a slab, but for the thinnest one.
SLAB_BYTES = 1 << 26


def blocks_of_slabs(index: MeshIndex, grid: Grid, width: float, sign: Sign) -> tuple[Tensor, Tensor, int]:
    """Blocks (N,3) int32 with a voxel in the band, their values (N,8,8,8), clamped, and how many are ambiguous."""
    blocks, values = [], []
    for begin, _, slab in index.slabs(grid, max_bytes=SLAB_BYTES, sign=sign):
        found, kept = _blocks_of_slab(slab.detach(), width)
        found[:, 0] += begin // BLOCK
        blocks.append(found)
        values.append(kept)
    all_blocks, all_values = torch.cat(blocks), torch.cat(values)
    ambiguous = 0
    if sign == "winding" and not index.closed:
        for some, theirs in zip(all_blocks.split(4096), all_values.split(4096), strict=True):
            place, *inner = (theirs.abs() < width).nonzero().unbind(-1)
            voxels = some[place].long() * BLOCK + torch.stack(inner, -1)
            winding = index.winding_number(voxel_points(grid, voxels))
            ambiguous += int(((winding - 0.5).abs() < 0.25).sum())
    return all_blocks, all_values, ambiguous


def _blocks_of_slab(slab: Tensor, width: float) -> tuple[Tensor, Tensor]:
    # Beyond the grid voxels have the width.
    size = [BLOCK * n for n in blocks_along((slab.shape[0], slab.shape[1], slab.shape[2]))]
    padded = slab.new_full(size, width)
    padded[: slab.shape[0], : slab.shape[1], : slab.shape[2]] = slab.clamp(-width, width)
    x, y, z = (n // BLOCK for n in size)
    parts = padded.reshape(x, BLOCK, y, BLOCK, z, BLOCK).permute(0, 2, 4, 1, 3, 5)
    blocks = (parts.abs() < width).flatten(3).any(-1).nonzero()
    return blocks.int(), parts[tuple(blocks.unbind(-1))]
