"""Blocks of 8^3 voxels that a surface crosses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.mesh import MOST_TRIANGLES
from sdm.engine.surface.voxel_blocks import SEGMENTS, VoxelBlocks, tables_on
from sdm.errors import SDMError
from sdm.kernels.launch import set_array, set_number
from sdm.kernels.surface.marching_cubes import Surface, count_blocks
from sdm.runtime.torch_warp import as_warp


@dataclass(frozen=True)
class ActiveBlocks:
    """Blocks that a surface crosses, as kernels take them.

    Args:
        voxels: `Voxels`.
        cases: `Cases`.
        surface: `Surface`, without the first vertices and triangles of segments.
        segments: 64 for each block.
        vertices: Of marching cubes.
        triangles: Of marching cubes.
        device: Where they are.
        memory: Tensors that kernels read.
    """

    voxels: Any
    cases: Any
    surface: Any
    segments: int
    vertices: int
    triangles: int
    device: torch.device
    memory: tuple[Tensor, ...]


def active_blocks(field: VoxelBlocks, level: float) -> ActiveBlocks | None:
    """The blocks that the surface crosses; None if none are. To be called with Warp on the current stream."""
    device = field.values.device
    voxels, (cases, tables) = field.as_struct(level), tables_on(device)
    counts = torch.zeros(2, field.blocks, dtype=torch.int32, device=device)
    count_blocks(voxels, cases, field.segments, as_warp(counts.reshape(-1), wp.int32))
    used = counts[0] + counts[1] > 0
    active = used.cumsum(0, dtype=torch.int32)
    # A wait for the device: all that follows has these sizes.
    vertices, triangles, count = torch.stack([*counts.sum(1), active[-1].long()]).tolist()
    if triangles == 0:
        return None
    refuse_many(triangles)
    active *= used
    # Blocks that are not active all write to the last place, which nobody reads.
    blocks = torch.empty(count + 1, dtype=torch.int32, device=device)
    numbers = torch.arange(field.blocks, dtype=torch.int32, device=device)
    blocks[torch.where(used, active - 1, count).long()] = numbers
    surface, memory = _surface(field.grid, blocks[:-1], active)
    memory = (*memory, *field.memory, *tables)
    return ActiveBlocks(voxels, cases, surface, SEGMENTS * count, vertices, triangles, device, memory)


def refuse_many(triangles: int) -> None:
    """Refuse a surface of more triangles than a mesh may have."""
    if triangles > MOST_TRIANGLES:
        raise SDMError(
            f"the surface has {triangles:,} triangles; at most {MOST_TRIANGLES:,} are supported: use a coarser grid, "
            "or a part of the map"
        )


def starts_of(counts: Tensor) -> Tensor:
    """The sum of all counts before each, along the last axis."""
    if counts.ndim > 1:
        # One at a time: of several rows a GPU has one block of threads sum each.
        return torch.stack([starts_of(row) for row in counts])
    return counts.cumsum(0, dtype=torch.int32) - counts


def _surface(grid: Grid, blocks: Tensor, active: Tensor) -> tuple[Any, tuple[Tensor, ...]]:
    edges = torch.empty(SEGMENTS * len(blocks), dtype=torch.int32, device=blocks.device)
    surface, axes = Surface(), grid.affine[:3, :3]
    surface.origin = wp.vec3d(*grid.origin)
    surface.axes = wp.mat33d(*axes.reshape(-1).tolist())
    set_number(surface, "mirrored", int(np.linalg.det(axes) < 0))
    set_array(surface, "blocks", as_warp(blocks, wp.int32))
    set_array(surface, "active", as_warp(active, wp.int32))
    set_array(surface, "edges", as_warp(edges, wp.int32))
    return surface, (blocks, active, edges)
