"""Build of a structure for one map, beside whose first stages parts of it are made.

Witnesses need no more than the tree and its triangles' frames: cones and features, which the neighbours are waited for,
and the boundary are on branches of the graph that is being recorded.
"""

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from sdm.engine.acceleration import AccelerationStructure, Sizes, fill_boundary, fill_surface, kind_of
from sdm.kernels.dense.query import Pending
from sdm.runtime.graphs.branches import Join, fork
from sdm.runtime.torch_warp import as_warp, on_current_stream
from sdm.topology.boundary_edges import MeshTopology


def build_beside(
    vertices: Tensor, faces: Tensor, topology: MeshTopology, join: Join | None = None
) -> tuple[AccelerationStructure, Pending]:
    """Queue the kernels of `acceleration.build`, for maps alone, and do nothing else.

    Args:
        vertices: (B,V,3) float32, contiguous.
        faces: (F,3) int32, the same.
        topology: Of the meshes.
        join: Called before the topology is read.

    Returns:
        The structure, and what has to be called before parts of it are looked at.
    """
    meshes, count, edges = vertices.shape[0], faces.shape[0], topology.boundary.shape[0]
    structure = AccelerationStructure.in_block(Sizes(meshes, count, edges, kind_of(edges, count)), vertices.device)
    unjoined: list[Join] = []
    begin = fork(vertices.device)
    bounds = torch.empty(6 * meshes, dtype=torch.float32, device=vertices.device)
    with on_current_stream(vertices, vertices, faces, *topology):
        room = as_warp(bounds, wp.float32)
        fill_surface(structure.view, vertices, faces, topology.neighbours, room, join, unjoined=unjoined)
    cones, features, kept = unjoined

    def boundary() -> Join:
        if join is not None:
            join()
        # `bounds` is kept until then, and what branches read until all are joined.
        return fill_boundary(structure, vertices, topology, as_warp(bounds, wp.float32), for_maps=True)

    def join_features(_kept: Join = kept) -> None:
        features()

    return structure, Pending(boundary, cones, join_features, begin)
