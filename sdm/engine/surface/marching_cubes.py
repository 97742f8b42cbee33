"""The surface of a map at a level, by marching cubes on the map's device (`sdm.kernels.surface`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.mesh import MOST_TRIANGLES, TriangleMesh
from sdm.core.sparse_sdm import SparseSDM
from sdm.engine.surface.voxel_blocks import SEGMENTS, VoxelBlocks, band_blocks, dense_blocks, tables_on
from sdm.errors import SDMError
from sdm.kernels.launch import set_array, set_number
from sdm.kernels.surface.marching_cubes import Surface, count_blocks, measure_segments, write_surface
from sdm.runtime.torch_warp import as_warp, on_current_stream


def isosurface(values: Tensor, grid: Grid, level: float) -> TriangleMesh:
    """The surface of a dense map, see `SDM.to_mesh`."""
    if min(grid.shape) < 2:
        raise SDMError(f"a grid of shape {grid.shape} is one voxel thin: a surface needs two along each axis")
    mesh = marching_cubes(dense_blocks(values, grid), level)
    if mesh is None:
        low, high = (float(bound) for bound in values.detach().aminmax())
        raise SDMError(f"the map runs from {low:g} to {high:g}: no surface at level {level:g}")
    return mesh


def band_isosurface(band: SparseSDM, level: float) -> TriangleMesh:
    """The surface of a narrow band, see `SparseSDM.to_mesh`."""
    reach = math.hypot(*band.grid.spacing)
    if not abs(level) + reach < band.width:
        raise SDMError(
            f"the band reaches {band.width:g} from the surface, but the cells that the level {level:g} crosses "
            f"{abs(level) + reach:g}: make it wider, or choose a level nearer to 0"
        )
    mesh = marching_cubes(band_blocks(band), level) if len(band) else None
    if mesh is None:
        raise SDMError(f"the band has no surface at level {level:g}")
    return mesh


def marching_cubes(field: VoxelBlocks, level: float) -> TriangleMesh | None:
    """The surface of blocks of voxels; None if there is none."""
    device = field.values.device
    voxels, (cases, tables) = field.as_struct(level), tables_on(device)
    counts = torch.zeros(2, field.blocks, dtype=torch.int32, device=device)
    with on_current_stream(counts, *field.memory, *tables):
        count_blocks(voxels, cases, field.segments, as_warp(counts.reshape(-1), wp.int32))
        used = counts[0] + counts[1] > 0
        active = used.cumsum(0, dtype=torch.int32)
        # The one wait for the device: all that follows has these sizes.
        vertex_count, triangle_count, block_count = torch.stack([*counts.sum(1), active[-1].long()]).tolist()
        if triangle_count == 0:
            return None
        if triangle_count > MOST_TRIANGLES:
            raise SDMError(
                f"the surface has {triangle_count:,} triangles; at most {MOST_TRIANGLES:,} are supported: use a "
                "coarser grid, or a part of the map"
            )
        active *= used
        # Blocks that are not active all write to the last place, which nobody reads.
        blocks = torch.empty(block_count + 1, dtype=torch.int32, device=device)
        numbers = torch.arange(field.blocks, dtype=torch.int32, device=device)
        blocks[torch.where(used, active - 1, block_count).long()] = numbers
        surface, memory = _surface(field.grid, blocks[:-1], active)
        segments = torch.empty(2, SEGMENTS * block_count, dtype=torch.int32, device=device)
        measure_segments(voxels, cases, surface, as_warp(segments.reshape(-1), wp.int32))
        first = segments.cumsum(1, dtype=torch.int32) - segments
        set_array(surface, "first_vertex", as_warp(first[0], wp.int32))
        set_array(surface, "first_triangle", as_warp(first[1], wp.int32))
        vertices = torch.empty(vertex_count, 3, dtype=torch.float32, device=device)
        faces = torch.empty(triangle_count, 3, dtype=torch.int32, device=device)
        write_surface(voxels, cases, surface, as_warp(vertices, wp.vec3), as_warp(faces, wp.vec3i))
        del memory
    return TriangleMesh(vertices, faces, "isosurface", check=False)


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
