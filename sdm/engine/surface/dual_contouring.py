"""The surface of a map at a level, by dual contouring on the map's device (`sdm.kernels.surface`)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.as_mesh import as_mesh
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.core.sparse_sdm import SparseSDM
from sdm.engine.mesh_index import MeshIndex
from sdm.engine.surface.active_blocks import ActiveBlocks, active_blocks, refuse_many, starts_of
from sdm.engine.surface.hermite_data import map_normals, mesh_crossings
from sdm.engine.surface.sharp_edges import with_sharp_edges
from sdm.engine.surface.voxel_blocks import VoxelBlocks
from sdm.kernels.launch import set_array
from sdm.kernels.surface.dual_cells import DualCells, decide_faces
from sdm.kernels.surface.dual_contouring import Hermite, measure_cells, write_dual
from sdm.kernels.surface.edge_points import count_edges, write_points
from sdm.kernels.surface.voxel_rows import BLOCK
from sdm.runtime.torch_warp import as_warp, on_current_stream

# Shares of the largest eigenvalue from which planes say where a vertex is: normals of a map are blurred at edges, those
# of a mesh are not.
LEAST_OF_MAP, LEAST_OF_MESH = 0.1, 0.01
# Voxels by which a vertex may leave its cell: a corner may be in one without a voxel inside.
REACH_OF_MAP, REACH_OF_MESH = 0.0, 1.0


def dual_contouring(field: VoxelBlocks, source: SDM | SparseSDM, level: float, mesh: Any) -> TriangleMesh | None:
    """The surface of blocks of voxels; None if there is none."""
    index = None
    if mesh is not None:
        index = mesh if isinstance(mesh, MeshIndex) else MeshIndex(as_mesh(mesh), field.values.device, warn=False)
    with on_current_stream(field.values, *field.memory):
        found = active_blocks(field, level)
        if found is None:
            return None
        edges = torch.empty(found.segments, dtype=torch.int32, device=found.device)
        count_edges(found.voxels, found.surface, as_warp(edges, wp.int32))
        first_edge = starts_of(edges)
        set_array(found.surface, "first_vertex", as_warp(first_edge, wp.int32))
        cells, memory = _cells(found)
        decide_faces(found.voxels, found.cases, found.surface, cells)
        counts = torch.empty(2, found.segments, dtype=torch.int32, device=found.device)
        measure_cells(found.voxels, found.cases, found.surface, cells, as_warp(counts.reshape(-1), wp.int32))
        first = starts_of(counts)
        set_array(cells, "first", as_warp(first[0], wp.int32))
        set_array(found.surface, "first_triangle", as_warp(first[1], wp.int32))
        vertex_count, triangle_count, edge_count = torch.stack([*counts.sum(1), edges.sum()]).tolist()
        refuse_many(triangle_count)
        if triangle_count == 0:
            return None
        points = torch.empty(edge_count, 3, dtype=torch.float32, device=found.device)
        ways = torch.empty_like(points)
        write_points(found.voxels, found.surface, as_warp(points, wp.vec3), as_warp(ways, wp.vec3))
    if index is None:
        normals = map_normals(source, points)
    else:
        points, normals = mesh_crossings(index, source.grid, level, points, ways)
    hermite = _hermite(source, points, normals, index is None)
    vertices = torch.empty(vertex_count, 3, dtype=torch.float32, device=found.device)
    faces = torch.empty(triangle_count, 3, dtype=torch.int32, device=found.device)
    with on_current_stream(vertices, *found.memory, *memory, points, normals, first, first_edge):
        write_dual(
            found.voxels,
            found.cases,
            found.surface,
            cells,
            hermite,
            as_warp(vertices, wp.vec3),
            as_warp(faces, wp.vec3i),
        )
    surface = TriangleMesh(vertices, faces, "isosurface", check=False)
    if index is None or level != 0:
        return surface
    return with_sharp_edges(surface, index, max(source.grid.spacing))


def _cells(found: ActiveBlocks) -> tuple[Any, tuple[Tensor, ...]]:
    sizes = {"inside": BLOCK * found.segments, "cases": BLOCK * found.segments}
    sizes |= {"joined": found.segments, "loops": found.segments}
    cells, memory = DualCells(), {}
    for name, size in sizes.items():
        memory[name] = torch.empty(size, dtype=torch.int32, device=found.device)
        set_array(cells, name, as_warp(memory[name], wp.int32))
    return cells, tuple(memory.values())


def _hermite(source: SDM | SparseSDM, points: Tensor, normals: Tensor, of_map: bool) -> Any:
    found = Hermite()
    set_array(found, "points", as_warp(points.contiguous(), wp.vec3))
    set_array(found, "normals", as_warp(normals.contiguous(), wp.vec3))
    found.least = wp.float64(LEAST_OF_MAP if of_map else LEAST_OF_MESH)
    found.reach = wp.float64(REACH_OF_MAP if of_map else REACH_OF_MESH)
    found.inverse = wp.mat33d(*np.linalg.inv(source.grid.affine[:3, :3]).reshape(-1).tolist())
    return found
