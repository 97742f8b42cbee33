"""Lists of meshes that differ, and other libraries' batches of them, told from batches of vertices; a batch's box."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32, Int32
from torch import Tensor

from sdm.core.mesh import TriangleMesh

# Parts of a batch of vertices.
_ARRAYS = (Tensor, np.ndarray, list, int, float, np.number)


def are_meshes(given: Any) -> bool:
    """True for meshes in a list, or one by one from an iterator, and not for arrays that are a batch of vertices.

    A batch of PyTorch3D or Kaolin is a list too: see `each_of`.
    """
    if not isinstance(given, list | tuple):
        return isinstance(given, Iterator) or hasattr(given, "faces_list") or hasattr(given, "batching")
    return not given or any(not isinstance(each, _ARRAYS) for each in given if not _is_row(each))


def each_of(given: Any) -> Any:
    """The meshes of another library's batch in a list of (vertices, faces); any other list or iterator as it is."""
    if hasattr(given, "faces_list"):
        return list(zip(given.verts_list(), given.faces_list(), strict=True))
    if hasattr(given, "batching"):
        vertices, faces = given.vertices, given.faces
        if not isinstance(vertices, list | tuple) and vertices.ndim == 2:
            return [(vertices, faces)]
        is_shared = not isinstance(faces, list | tuple) and faces.ndim == 2
        return list(zip(vertices, [faces] * len(vertices) if is_shared else faces, strict=True))
    return given


def _is_row(each: Any) -> bool:
    # A pair may be (vertices, faces); other tuples are rows of nested ones.
    return isinstance(each, tuple) and len(each) != 2


def box_of(batch: Float32[Tensor, "b v 3"], faces: Int32[Tensor, "f 3"]) -> TriangleMesh:
    """A triangle with the box of a batch of meshes."""
    used = batch.detach()[:, faces.reshape(-1).long()]
    low, high = used.amin((0, 1)), used.amax((0, 1))
    return TriangleMesh(torch.stack([low, high, low]), [[0, 1, 2]], "the batch")
