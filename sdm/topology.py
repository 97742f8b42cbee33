"""Which edges bound a mesh: what is left when every face's directed edges are added up."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.errors import MeshError

# The boundary by indices of faces seen before: a stream asks about the same faces for every batch.
_seen: WeakIdKeyDictionary = WeakIdKeyDictionary()


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
    # Tensors made in inference mode keep no count of changes, so nothing is remembered about them.
    now = None if faces.is_inference() else faces._version
    known: tuple[int | None, Tensor] | None = _seen.get(faces)
    if known is None or known[0] is None or known[0] != now:
        _check_range(faces, vertices.shape[-2])
        known = (now, _unpaired(faces.long(), vertices.shape[-2]))
        _seen[faces] = known
    edges = known[1]
    if edges.shape[0] == 0:
        return edges
    same = _first_with_position(vertices.detach().reshape(-1, vertices.shape[-2], 3))
    return _unpaired(same[faces.long()], vertices.shape[-2])


def _check_range(faces: Tensor, count: int) -> None:
    low, high = (int(bound) for bound in faces.aminmax())
    if low < 0 or high >= count:
        bad = low if low < 0 else high
        raise MeshError(f"a face uses vertex {bad}, but the {count} vertices are numbered 0 to {count - 1}")


def _unpaired(faces: Tensor, count: int) -> Tensor:
    start = faces.reshape(-1)
    end = faces.roll(-1, 1).reshape(-1)
    low, high = torch.minimum(start, end), torch.maximum(start, end)
    keep = low != high
    key = (low * count + high)[keep]
    direction = torch.where(start < end, 1, -1)[keep].int()
    key, order = key.sort()
    key, which = torch.unique_consecutive(key, return_inverse=True)
    left_over = torch.zeros_like(key, dtype=torch.int32).index_add_(0, which, direction[order])
    open_ = left_over.nonzero().squeeze(1)
    times = left_over[open_]
    low, high = key[open_] // count, key[open_] % count
    forward = times > 0
    edges = torch.stack([torch.where(forward, low, high), torch.where(forward, high, low)], 1)
    return edges.repeat_interleave(times.abs(), 0).int()


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
