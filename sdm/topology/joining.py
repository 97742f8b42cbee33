"""Boundary edges once vertices at equal positions count as one.

Only the edges that faces leave unmatched by their vertices' indices matter here, and only the ends of those. Any other
pair of vertices has as many faces' edges in one direction as in the other, and wherever its two ends move, both
directions move alike: it goes on adding nothing to any edge. So the sums over the unmatched edges are the sums over
all edges, and a vertex that ends none of them is of no interest, whatever its position.

An end is replaced by the first of all ends at its position, and edges come sorted by their lower vertex, then their
higher, so that the result depends on neither the order of the edges nor on where it is found.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor


def join_on_host(unmatched: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Boundary edges (E,2) int32, for few unmatched edges.

    Args:
        unmatched: (N,3) int32: two vertices, and how many more edges lead from the first to the second than back.
        places: (2 * N, K) float32, the ends' coordinates in all meshes.
    """
    ends = unmatched[:, :2].ravel()
    # Adding zero makes -0 and +0 one; then the bytes are equal where the numbers are. They sort in one go, however
    # many meshes there are, and any order will do that puts equal ones together.
    places = (places + np.float32(0.0)).view(np.int32)
    order = np.argsort(places.view(f"S{4 * places.shape[1]}").ravel())
    places = places[order]
    begins = _begins((places[1:] != places[:-1]).any(1))
    first = np.minimum.reduceat(ends[order], np.flatnonzero(begins))
    same = np.empty_like(ends)
    same[order] = first[np.cumsum(begins) - 1]

    start, end = same.reshape(-1, 2).T
    times = np.sign(end - start) * unmatched[:, 2]
    keys = np.minimum(start, end).astype(np.int64) << 32 | np.maximum(start, end)
    order = np.argsort(keys)
    keys = keys[order]
    begins = np.flatnonzero(_begins(keys[1:] != keys[:-1]))
    balance = np.add.reduceat(times[order], begins)
    keys = np.repeat(np.where(balance > 0, keys[begins], _turned(keys[begins])), np.abs(balance))
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], 1).astype(np.int32)


def join_on_device(unmatched: Tensor, vertices: Tensor) -> Tensor:
    """The same of `vertices` (B,V,3), by torch on their device, which it waits for twice."""
    ends = unmatched[:, :2].long()
    # In an ordinary mesh few of all vertices, and each ends two edges.
    same = torch.zeros(vertices.shape[1], dtype=torch.int64, device=ends.device)
    used = same.index_fill_(0, ends.reshape(-1), 1).nonzero().squeeze(1)
    # Adding zero makes -0 and +0 one; the bits then compare as the numbers do.
    places = (vertices[:, used] + 0.0).permute(0, 2, 1).reshape(-1, len(used)).view(torch.int32)
    order = places[0].sort(stable=True)[1]
    for column in places[1:]:
        order = order[column[order].sort(stable=True)[1]]
    changes = torch.zeros(len(used) - 1, dtype=torch.bool, device=ends.device)
    for column in places:
        ordered = column[order]
        changes |= ordered[1:] != ordered[:-1]
    group, used = _groups(changes), used[order]
    first = torch.full_like(used, vertices.shape[1]).scatter_reduce_(0, group, used, "amin")
    same[used] = first[group]

    start, end = same[ends].unbind(1)
    times = (end - start).sign() * unmatched[:, 2]
    keys, order = (torch.minimum(start, end) << 32 | torch.maximum(start, end)).sort()
    group = _groups(keys[1:] != keys[:-1])
    balance = torch.zeros_like(keys).scatter_add_(0, group, times[order])
    # As long as the edges, with nothing beyond the last group: its length is known without a look.
    keys = torch.zeros_like(keys).scatter_(0, group, keys)
    keys = torch.where(balance > 0, keys, _turned(keys)).repeat_interleave(balance.abs())
    return torch.stack([keys >> 32, keys & 0xFFFFFFFF], 1).int()


def _turned(keys: Any) -> Any:
    return (keys & 0xFFFFFFFF) << 32 | keys >> 32


def _begins(changes: np.ndarray) -> np.ndarray:
    """Starts of groups, given the neighbours between which something changes."""
    return np.concatenate([[True], changes])


def _groups(changes: Tensor) -> Tensor:
    """The number of each one's group, int64."""
    return torch.nn.functional.pad(changes.cumsum(0), (1, 0))
