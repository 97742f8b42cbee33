"""Planes of maps that are never whole: only what a page shows is computed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM


class ComputedPlanes:
    """A map by what computes it on a grid of one layer.

    Args:
        grid: Of the whole map.
        compute: From a grid to the map's values (nx,ny,nz) there.
    """

    def __init__(self, grid: Grid, compute: Callable[[Grid], SDM | Tensor]) -> None:
        self.grid, self._compute = grid, compute
        self._known: tuple[tuple[int, float], np.ndarray] | None = None

    def on_plane(self, axis: int, place: float) -> Float32[np.ndarray, "n m"]:
        """Values on the plane across an axis of the grid at a place in voxels, along the two axes that follow it."""
        if self._known is None or self._known[0] != (axis, place):
            index = [0.0, 0.0, 0.0]
            index[axis] = place
            shape = list(self.grid.shape)
            shape[axis] = 1
            affine = self.grid.affine
            origin = affine[:3, 3] + affine[:3, :3] @ np.array(index)
            layer = Grid(origin, self.grid.spacing, shape, self.grid.direction)
            with torch.no_grad():
                found = self._compute(layer)
            values = (found.values if isinstance(found, SDM) else found).cpu().numpy().squeeze(axis)
            # What is left of (x, y, z) is in their order, and of y it is (x, z).
            self._known = (axis, place), values.T if axis == 1 else values
        return self._known[1]
