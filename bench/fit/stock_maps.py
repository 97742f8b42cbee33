"""Whole signed distance maps by a stock library on the CPU, their derivatives by finite differences.

What one has who puts a stock library's map where Wang et al. put their mesh's: for every shape the map of the grid
that the surrogates answer on, cubic splines between its voxels, and one map more for each shape parameter's derivative.
"""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.bench.fit.stock_backend import STEP_OF_RANGE, StockBackend
from sdm.bench.peers.warp import StockWarp
from sdm.core.grid import Grid
from sdm.fit.model.exact import TRIANGLES
from sdm.fit.model.spline_backend import GridBackend
from sdm.surrogate import GRID

# Splines through exact values 0.2 mm apart are nearer than this to the distances near the surface [mm].
SLACK = 0.05


class StockMaps(GridBackend):
    """A library's maps of the same meshes as the exact backend's.

    Args:
        library: "libigl" or "warp".
        triangles: As the exact backend's.
        grid: The maps' grid.
    """

    def __init__(self, library: str, triangles: int = TRIANGLES, grid: Grid = GRID) -> None:
        self._stock = StockBackend(library, triangles)
        super().__init__(lambda theta: theta, grid, self._stock.parameters, name=f"{library}-map", slack=SLACK)
        self.centre = self._stock.centre
        self._points = grid.points().reshape(-1, 3)
        self._known: tuple[Tensor, Tensor] | None = None

    def rough(self) -> StockMaps | None:
        """As the exact backend's."""
        stock = self._stock.rough()
        if stock is None:
            return None
        rough = StockMaps(self._stock.library, stock.family.faces.shape[0], self.grid)
        rough.name, rough.centre = f"{self.name}, rough", self.centre
        return rough

    def maps(self, theta: Tensor, derivatives: bool) -> Tensor:
        """See `GridBackend.maps`."""
        if self._known is None or not torch.equal(theta, self._known[0]):
            self._known = theta, self._map(theta)
        values = self._known[1]
        found = [values]
        for column, parameter in enumerate(self.parameters if derivatives else ()):
            step = torch.zeros_like(theta)
            step[column] = STEP_OF_RANGE * (parameter.high - parameter.low)
            found.append((self._map(theta + step) - values) / step[column])
            self.evaluations += 1
        return torch.stack(found)

    def _map(self, theta: Tensor) -> Tensor:
        peer = self._stock.built(theta)
        if isinstance(peer, StockWarp):
            return peer.signed_distance_map(self.grid).double()
        return peer.signed_distance(self._points).reshape(self.grid.shape).double()
