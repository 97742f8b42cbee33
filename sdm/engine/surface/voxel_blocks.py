"""Values of a map as surface kernels take them, of dense maps and of narrow bands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.sparse_sdm import SparseSDM
from sdm.kernels.launch import set_array, set_number
from sdm.kernels.surface.cell_cases import cell_cases
from sdm.kernels.surface.segment_cells import Cases
from sdm.kernels.surface.voxel_rows import BLOCK, SEGMENTS, Voxels
from sdm.runtime.torch_warp import as_warp


@dataclass(frozen=True)
class VoxelBlocks:
    """A map in blocks of 8^3 voxels.

    Args:
        values: (nx,ny,nz) float32, or (N,8,8,8).
        grid: Where they are.
        blocks: Number of blocks.
        segments: Number of segments that have to be looked at.
        fill: Writes the values' places into a `Voxels` struct.
        memory: Tensors that kernels read.
    """

    values: Tensor
    grid: Grid
    blocks: int
    segments: int
    fill: Callable[[Any], None]
    memory: tuple[Tensor, ...]

    def as_struct(self, level: float) -> Any:
        """The values as kernels take them."""
        found = Voxels()
        found.shape = wp.vec3i(*self.grid.shape)
        found.along = wp.vec3i(*(-(-n // BLOCK) for n in self.grid.shape))
        found.level = wp.float32(level)
        self.fill(found)
        return found


def dense_blocks(values: Tensor, grid: Grid) -> VoxelBlocks:
    """The blocks of a dense map (nx,ny,nz)."""
    nx, ny, nz = grid.shape
    along = [-(-n // BLOCK) for n in grid.shape]
    values = values.detach().to(torch.float32).contiguous()

    def fill(voxels: Any) -> None:
        set_number(voxels, "dense", 1)
        set_array(voxels, "values", as_warp(values.reshape(nx * ny, nz), wp.float32))

    return VoxelBlocks(values, grid, along[0] * along[1] * along[2], nx * ny * along[2], fill, (values,))


def band_blocks(band: SparseSDM) -> VoxelBlocks:
    """The blocks of a narrow band, with those next to each."""
    values = band.values.detach().to(torch.float32).contiguous()
    blocks, count = band.blocks.contiguous(), len(band)
    ways = torch.cartesian_prod(*[torch.arange(2, dtype=torch.int32, device=values.device)] * 3)
    neighbours = band.find(blocks[:, None] + ways).to(torch.int32).contiguous()

    def fill(voxels: Any) -> None:
        set_number(voxels, "dense", 0)
        set_array(voxels, "values", as_warp(values.reshape(count * SEGMENTS, BLOCK), wp.float32))
        set_array(voxels, "blocks", as_warp(blocks, wp.int32))
        set_array(voxels, "neighbours", as_warp(neighbours.reshape(-1), wp.int32))

    return VoxelBlocks(values, band.grid, count, SEGMENTS * count, fill, (values, blocks, neighbours))


@cache
def _tables(device: torch.device) -> dict[str, Tensor]:
    return {name: torch.from_numpy(table).to(device) for name, table in vars(cell_cases()).items()}


def tables_on(device: torch.device) -> tuple[Any, tuple[Tensor, ...]]:
    """The cases of cells on a device, and the memory that holds them."""
    found, tables = Cases(), _tables(device)
    for name, table in tables.items():
        set_array(found, name, as_warp(table, wp.int32))
    return found, tuple(tables.values())


__all__ = ["SEGMENTS", "VoxelBlocks", "band_blocks", "dense_blocks", "tables_on"]
