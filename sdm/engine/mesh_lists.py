"""Lists of meshes that differ, told from batches of vertices, and their grids; the box of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32, Int32
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.errors import GridError

# Parts of a batch of vertices.
_ARRAYS = (Tensor, np.ndarray, list, int, float, np.number)


def are_meshes(given: Any) -> bool:
    """True for a list of meshes, and not of arrays that are a batch of vertices."""
    return isinstance(given, list | tuple) and any(not isinstance(each, _ARRAYS) for each in given if not _is_row(each))


def _is_row(each: Any) -> bool:
    # A pair may be (vertices, faces); other tuples are rows of nested ones.
    return isinstance(each, tuple) and len(each) != 2


def box_of(batch: Float32[Tensor, "b v 3"], faces: Int32[Tensor, "f 3"]) -> TriangleMesh:
    """A triangle with the box of a batch of meshes."""
    used = batch.detach()[:, faces.reshape(-1).long()]
    low, high = used.amin((0, 1)), used.amax((0, 1))
    return TriangleMesh(torch.stack([low, high, low]), [[0, 1, 2]], "the batch")


def grids_of(meshes: Sequence[Any], grids: Any) -> Sequence[Any]:
    """A grid, or a resolution, for each mesh: those of a list of grids, or one for all.

    Raises:
        GridError: As many grids as meshes are needed, and there are others.
    """
    if not (isinstance(grids, list | tuple) and any(isinstance(grid, Grid) for grid in grids)):
        return [grids] * len(meshes)
    if len(grids) != len(meshes):
        raise GridError(f"{len(meshes)} meshes and {len(grids)} grids were given: give one grid, or one for each mesh")
    return grids
