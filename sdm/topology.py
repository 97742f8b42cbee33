"""Which edges bound a mesh: what is left when every face's directed edges are added up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import warp as wp
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.errors import MeshError
from sdm.kernels.edges import REMARKS, bits_for, pair_edges
from sdm.kernels.launch import launch
from sdm.memory import as_warp, on_current_stream, scratch_on

# What is known of faces seen before: a stream asks about the same faces for every batch.
_seen: WeakIdKeyDictionary = WeakIdKeyDictionary()
_seen_loops: WeakIdKeyDictionary = WeakIdKeyDictionary()


def boundary_edges(vertices: Tensor, faces: Tensor) -> Tensor:
    """Directed boundary edges of a mesh, or of a batch of meshes that share faces.

    Args:
        vertices: (V,3) or (B,V,3) float32.
        faces: (F,3) int32.

    Returns:
        (E,2) int32 vertex indices, the surface on the left. An edge whose directions do not cancel stands as often
        as they are left over. Empty means closed: the winding number is a whole number everywhere off the surface.

    Vertices at exactly equal positions count as one, as in an STL file, if that is so in every mesh of the batch.

    Raises:
        MeshError: A face index out of range.
    """
    found, _ = _paired(faces, vertices.shape[-2])
    if found.shape[0] == 0:
        return found
    same = _first_with_position(vertices.detach().reshape(-1, vertices.shape[-2], 3))
    return _pair_up(same[faces.long()].int(), vertices.shape[-2])[0]


def neighbours(faces: Tensor, count: int) -> Tensor:
    """For each face its neighbours, and which of its edges and corners it lists for them all.

    Args:
        faces: (F,3) int32.
        count: Number of vertices.

    Returns:
        (F,4) int32. Column k < 3: another face at the edge from corner k to the next, as 3 * face + edge, or -1. Column
        3: bits of what the face owns, 2, 4 and 8 for its edges, 16, 32 and 64 for its corners; the first face at an
        edge or a corner owns it. Of an edge from a vertex to itself nobody needs to know.

    Raises:
        MeshError: A face index out of range.
    """
    return _paired(faces, count)[1]


def _paired(faces: Tensor, count: int) -> tuple[Tensor, Tensor]:
    return _remembered(_seen, faces, lambda: _pair_up(faces, count))


def _pair_up(faces: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Boundary edges by vertex indices, and `neighbours`, from one sort of all edges; waits for the device once."""
    faces = faces.contiguous()
    total = faces.numel()
    first = torch.full((count,), total, dtype=torch.int32, device=faces.device)
    remarks = torch.zeros(REMARKS, dtype=torch.int32, device=faces.device)
    keys = torch.empty(2 * total, dtype=torch.int64, device=faces.device)
    left_over = torch.empty(total, dtype=torch.int32, device=faces.device)
    shared = torch.empty(faces.shape[0], 4, dtype=torch.int32, device=faces.device)
    with on_current_stream(faces, faces):
        pair_edges(
            as_warp(faces, wp.int32),
            as_warp(first, wp.int32),
            as_warp(remarks, wp.int32),
            as_warp(keys, wp.int64),
            as_warp(left_over, wp.int32),
            as_warp(shared, wp.int32),
            launch,
            scratch_on(faces.device),
        )
    out_of_range, open_edges = remarks.tolist()
    if out_of_range:
        low, high = (int(bound) for bound in faces.aminmax())
        bad = low if low < 0 else high
        raise MeshError(f"a face uses vertex {bad}, but the {count} vertices are numbered 0 to {count - 1}")
    if not open_edges:
        return faces.new_empty((0, 2)), shared
    at = left_over.nonzero().squeeze(1)
    times, key, bits = left_over[at], keys[at], bits_for(count)
    ends = torch.stack([key >> bits, key & ((1 << bits) - 1)], 1)
    ends = torch.where(times[:, None] > 0, ends, ends.flip(1))
    return ends.repeat_interleave(times.abs(), 0).int(), shared


def _remembered(seen: WeakIdKeyDictionary, faces: Tensor, find: Callable[[], Any]) -> Any:
    # Tensors made in inference mode keep no count of changes, so nothing is remembered about them.
    now = None if faces.is_inference() else faces._version
    known: tuple[int | None, Any] | None = seen.get(faces)
    if known is None or known[0] is None or known[0] != now:
        known = (now, find())
        seen[faces] = known
    return known[1]


def loops(edges: Tensor) -> Tensor:
    """For each boundary edge of (E,2), directed as `boundary_edges` gives them, the number of its loop: (E,) int32.

    Loops that meet at a vertex count as one. In a loop as many edges end at each vertex as begin there.
    """

    def find() -> Tensor:
        host = edges.cpu().numpy()
        ends, index = np.unique(host, return_inverse=True)
        start, end = index.reshape(host.shape).T
        graph = coo_matrix((np.ones(len(start)), (start, end)), shape=(len(ends), len(ends)))
        return torch.from_numpy(connected_components(graph, directed=False)[1][start].astype(np.int32)).to(edges.device)

    return _remembered(_seen_loops, edges, find)


def _first_with_position(vertices: Tensor) -> Tensor:
    """For each vertex of (B,V,3) the first one at its position in every mesh of the batch, (V,) int64."""
    count = vertices.shape[1]
    group = torch.zeros(count, dtype=torch.int64, device=vertices.device)
    # Adding zero makes -0 and +0 one; the bits then sort and compare as well as the numbers do.
    columns = (vertices + 0.0).permute(0, 2, 1).reshape(-1, count).view(torch.int32)
    for column in columns:
        _, group = torch.unique((group << 32) + column.long(), return_inverse=True)
    first = torch.full((count,), count, dtype=torch.int64, device=vertices.device)
    first.scatter_reduce_(0, group, torch.arange(count, device=vertices.device), "amin")
    return first[group]
