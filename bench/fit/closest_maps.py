"""Whole maps and their derivatives by the closest points of one query a shape: our engine's or a stock library's.

What a surrogate gives, by the meshes themselves: a map on the surrogates' grid, the derivative of each voxel's distance
by each parameter from where its closest point moves, cubic splines between the voxels, and anchors near the end. So
both engines fill the same grids from the same meshes and end at the exact estimate.
"""

from __future__ import annotations

from typing import Any, cast

import torch
from torch import Tensor

from sdm.bench.fit.stock_closest import ClosestPointBackend
from sdm.bench.fit.stock_maps import SLACK
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.closest_points import Closest
from sdm.engine.mesh_index import MeshIndex
from sdm.engine.points import PointsIndex
from sdm.fit import ExactBackend
from sdm.fit.model.exact import ROUGH_TRIANGLES, TRIANGLES
from sdm.fit.model.spline_backend import GridBackend
from sdm.runtime.threads import threads
from sdm.shapes import Cochlea, Family
from sdm.surrogate import GRID


class ClosestMaps(GridBackend):
    """Maps of the exact backend's meshes on a grid.

    Args:
        library: "exact" or "libigl".
        triangles: As the exact backend's.
        grid: The maps' grid.
    """

    def __init__(self, library: str, triangles: int = TRIANGLES, grid: Grid = GRID) -> None:
        family = Cochlea(triangles)
        exact = (ExactBackend if library == "exact" else ClosestPointBackend)(family, "cpu")
        super().__init__(lambda theta: theta, grid, exact.parameters, name=f"{exact.name}, maps", exact=exact)
        self.slack, self.centre, self._library = SLACK, exact.centre, library
        self._meshes = _EngineMaps(family, grid) if library == "exact" else exact
        self._points = grid.points().reshape(-1, 3).double()

    def rough(self) -> ClosestMaps | None:
        """As the exact backend's."""
        if self._meshes.faces.shape[0] <= 2 * ROUGH_TRIANGLES:
            return None
        rough = ClosestMaps(self._library, ROUGH_TRIANGLES, self.grid)
        rough.name, rough.centre = f"{self.name}, rough", self.centre
        return rough

    def maps(self, theta: Tensor, derivatives: bool) -> Tensor:
        """See `GridBackend.maps`."""
        with threads(self._threads):
            if not derivatives:
                return self._meshes.distances(theta, self._points).reshape(1, *self.grid.shape)
            found = self._meshes.with_derivatives(theta, self._points)
            return torch.cat([found.values[None], found.by_theta.T]).reshape(-1, *self.grid.shape)


class _EngineMaps(ExactBackend):
    """The exact backend, asked about the voxels of one grid alone: by our maps in the place of points."""

    def __init__(self, family: Family, grid: Grid) -> None:
        super().__init__(family, "cpu")
        self.grid = grid

    def _indexed(self, mesh: TriangleMesh) -> PointsIndex:
        return cast("PointsIndex", _MapIndex(MeshIndex(mesh, "cpu"), self.grid))


class _MapIndex:
    def __init__(self, index: MeshIndex, grid: Grid) -> None:
        self._index, self._grid = index, grid

    def signed_distance(self, points: Tensor, *, return_closest: bool = False) -> Any:
        """Of the grid's voxels, which `points` are."""
        if not return_closest:
            return self._index.signed_distance_map(self._grid).values.reshape(-1)
        field, hit = self._index.signed_distance_map(self._grid, return_closest=True)
        places = (hit.points.reshape(-1, 3), hit.faces.reshape(-1), hit.barycentric.reshape(-1, 3))
        return field.values.reshape(-1), Closest(*places)
