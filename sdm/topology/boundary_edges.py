"""Boundary edges of meshes: what is left when every face's directed edges are added up."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
import warp as wp
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.kernels.topology.edge_pairing import gather_ends
from sdm.runtime.torch_warp import as_warp, on_current_stream
from sdm.topology.face_pairing import cached, pairing_of
from sdm.topology.joining import join_on_device, join_on_host

# Up to this many unmatched edges, and this many in all meshes, are joined on the host: on a GPU each of the many small
# steps costs more than its work.
MOST_ON_HOST = 1 << 12
MOST_ON_HOST_IN_ALL = 1 << 19

_known_host: WeakIdKeyDictionary = WeakIdKeyDictionary()


class MeshTopology(NamedTuple):
    """Neighbours and boundary edges of a mesh's faces, all int32.

    Args:
        neighbours: (F,4), see `neighbours`.
        boundary: (E,2), see `boundary_edges`.
        caps: (E,3), see `cap_triangles`; any tensor where nobody looks at it.
    """

    neighbours: Tensor
    boundary: Tensor
    caps: Tensor


def boundary_edges(vertices: Tensor, faces: Tensor) -> Tensor:
    """Directed boundary edges of a mesh, or of a batch of meshes that share faces.

    Args:
        vertices: (V,3) or (B,V,3) float32.
        faces: (F,3) int32.

    Returns:
        (E,2) int32 vertex indices, the surface on the left, sorted by the lower of both, then the higher. An edge
        whose directions do not cancel stands as often as they are left over. Empty means closed: the winding number
        is a whole number everywhere off the surface. Nobody may write into it: the next call may return the same.

    Vertices at exactly equal positions count as one, as in an STL file, if that is so in every mesh of the batch: as
    the first of those at which an edge is unmatched by its indices.

    Raises:
        MeshError: A face index out of range.
    """
    count = vertices.shape[-2]
    paired = pairing_of(faces, count)
    if paired.unmatched.shape[0] == 0:
        return paired.unmatched[:, :2]
    batch = vertices.detach().reshape(-1, count, 3)
    edges = paired.unmatched.shape[0]
    if edges > MOST_ON_HOST or edges * batch.shape[0] > MOST_ON_HOST_IN_ALL:
        found = join_on_device(paired.unmatched, batch)
        if paired.unmatched.untyped_storage().nbytes() > paired.unmatched.nbytes:
            # A part of a larger tensor would keep it all.
            paired.unmatched = paired.unmatched.clone()
        return found
    paired.unmatched, found = joined_on_host(paired.unmatched, batch)
    # As long as a mesh that moves keeps its boundary, so do those who remember something about it.
    if paired.edges is None or not np.array_equal(on_host(paired.edges), found):
        paired.edges, paired.same = torch.from_numpy(found).to(faces.device), None
        cached(_known_host, paired.edges, lambda: found)
    return paired.edges


def joined_on_host(unmatched: Tensor, vertices: Tensor) -> tuple[Tensor, np.ndarray]:
    """The unmatched edges, in memory of their own, and the boundary edges; waits for the device once."""
    count, meshes = unmatched.shape[0], vertices.shape[0]
    vertices = vertices.contiguous()
    # One piece of memory, so that one copy brings it to the host.
    both = torch.empty(3 * count + 6 * count * meshes, dtype=torch.int32, device=unmatched.device)
    rows, places = both.split([3 * count, 6 * count * meshes])
    rows = rows.view(count, 3)
    with on_current_stream(vertices, vertices, unmatched):
        gather_ends(
            as_warp(unmatched, wp.int32),
            as_warp(vertices, wp.vec3),
            as_warp(rows, wp.int32),
            as_warp(places.view(torch.float32).view(2 * count, meshes, 3), wp.vec3),
        )
    host = both.cpu().numpy()
    bits = host[3 * count :].reshape(2 * count, 3 * meshes)
    return rows, join_on_host(host[: 3 * count].reshape(count, 3), bits.view(np.float32))


def on_host(edges: Tensor) -> np.ndarray:
    """Boundary edges (E,2) as an array, copied once."""
    return cached(_known_host, edges, lambda: edges.cpu().numpy().copy())
