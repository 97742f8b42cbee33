"""The surface of a map at a level, by marching cubes on the map's device (`sdm.kernels.surface`)."""

from __future__ import annotations

import torch
import warp as wp

from sdm.core.mesh import TriangleMesh
from sdm.engine.surface.active_blocks import active_blocks, starts_of
from sdm.engine.surface.voxel_blocks import VoxelBlocks
from sdm.kernels.launch import set_array
from sdm.kernels.surface.marching_cubes import measure_segments, write_surface
from sdm.runtime.torch_warp import as_warp, on_current_stream


def marching_cubes(field: VoxelBlocks, level: float) -> TriangleMesh | None:
    """The surface of blocks of voxels; None if there is none."""
    with on_current_stream(field.values, *field.memory):
        found = active_blocks(field, level)
        if found is None:
            return None
        segments = torch.empty(2, found.segments, dtype=torch.int32, device=found.device)
        measure_segments(found.voxels, found.cases, found.surface, as_warp(segments.reshape(-1), wp.int32))
        first = starts_of(segments)
        set_array(found.surface, "first_vertex", as_warp(first[0], wp.int32))
        set_array(found.surface, "first_triangle", as_warp(first[1], wp.int32))
        vertices = torch.empty(found.vertices, 3, dtype=torch.float32, device=found.device)
        faces = torch.empty(found.triangles, 3, dtype=torch.int32, device=found.device)
        write_surface(found.voxels, found.cases, found.surface, as_warp(vertices, wp.vec3), as_warp(faces, wp.vec3i))
    return TriangleMesh(vertices, faces, "isosurface", check=False)
