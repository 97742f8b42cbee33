"""Which edges bound a mesh: what is left when every face's directed edges are added up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.errors import MeshError

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
    edges, _ = _paired(faces, vertices.shape[-2])
    if edges.shape[0] == 0:
        return edges
    same = _first_with_position(vertices.detach().reshape(-1, vertices.shape[-2], 3))
    return _pair_up(same[faces.long()], vertices.shape[-2])[0]


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
    def find() -> tuple[Tensor, Tensor]:
        _check_range(faces, count)
        return _pair_up(faces.long(), count)

    return _remembered(_seen, faces, find)


def _pair_up(faces: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Boundary edges by vertex indices, and `neighbours`, from one sort of all edges."""
    start = faces.reshape(-1)
    end = faces.roll(-1, 1).reshape(-1)
    here = torch.arange(start.shape[0], device=faces.device)
    key, order = ((torch.minimum(start, end) << 32) + torch.maximum(start, end)).sort(stable=True)
    leads = torch.ones_like(key, dtype=torch.bool)
    leads[1:] = key[1:] != key[:-1]
    lead = torch.where(leads, here, 0).cummax(0).values
    ends = leads.roll(-1)

    # What is left over when the directions of an edge's faces are added up, known at the last of them.
    direction = (end - start).sign()[order]
    total = direction.cumsum(0)
    left_over = torch.where(ends, total - total[lead] + direction[lead], 0)
    times = left_over.nonzero().squeeze(1)
    forward = left_over[times] > 0
    low, high = key[times] >> 32, key[times] & 0xFFFFFFFF
    edges = torch.stack([torch.where(forward, low, high), torch.where(forward, high, low)], 1)
    edges = edges.repeat_interleave(left_over[times].abs(), 0).int()

    # The next face at the same edge; after the last comes the first.
    following = torch.where(ends, lead, here + 1)
    other = torch.empty_like(start)
    other[order] = order[following]
    other = torch.where((other == here) | (start == end), -1, other)
    owns_edge = torch.empty_like(start)
    owns_edge[order] = leads.long()
    owns_edge *= start != end
    first = torch.full((count,), start.shape[0], dtype=torch.int64, device=faces.device)
    first.scatter_reduce_(0, start, here // 3, "amin")
    owns_corner = (first[start] == here // 3).long()
    shift = here % 3
    bits = ((owns_edge << (shift + 1)) + (owns_corner << (shift + 4))).reshape(-1, 3).sum(1)
    return edges, torch.cat([other.reshape(-1, 3), bits[:, None]], 1).int()


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


def _check_range(faces: Tensor, count: int) -> None:
    low, high = (int(bound) for bound in faces.aminmax())
    if low < 0 or high >= count:
        bad = low if low < 0 else high
        raise MeshError(f"a face uses vertex {bad}, but the {count} vertices are numbered 0 to {count - 1}")


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
