"""Accessor of PyVista's surfaces: `mesh.sdm.signed_distance_map(128)`.

PyVista 0.48 and later find it by the entry point `pyvista.accessors`; with others import this module.
"""

from __future__ import annotations

from typing import Any

from sdm.core.as_grid import as_grid
from sdm.core.as_mesh import as_mesh
from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.core.to_libraries import imported
from sdm.engine.mesh_index import MeshIndex

# By its name, as this module has the same.
_pyvista: Any = imported("pyvista", "pyvista")


class SurfaceAccessor:
    """Signed distances of a PyVista surface, negative inside; what is built for it is kept until the mesh changes."""

    def __init__(self, mesh: Any) -> None:
        self._mesh = mesh
        self._known: tuple[Any, MeshIndex] | None = None

    def signed_distance_map(self, grid: Any = 128, **options: Any) -> Any:
        """The exact signed distance map as a `pyvista.ImageData` with the array `implicit_distance`.

        Args:
            grid: Voxels along each axis of a cube around the mesh, or what else `sdm.core.as_grid` takes.
            options: Those of `MeshIndex.signed_distance_map`.
        """
        return self._map(as_grid(grid, as_mesh(self._mesh)), options).to_pyvista()

    def signed_distance(self, points: Any) -> Any:
        """Signed distances (...) float32, NumPy, of points (...,3) or of the points of another dataset."""
        at = points.points if hasattr(points, "points") else points
        return self._index().signed_distance(at).cpu().numpy()

    def inspect(self) -> Any:
        """The report of `sdm.inspect_mesh`."""
        from sdm.inspect import inspect_mesh

        return inspect_mesh(self._mesh)

    def _map(self, grid: Grid, options: dict[str, Any]) -> SDM:
        return self._index().signed_distance_map(grid, **options)

    def _index(self) -> MeshIndex:
        # VTK counts changes of points and faces.
        state = self._mesh.GetMTime(), self._mesh.points.VTKObject.GetMTime()
        if self._known is None or self._known[0] != state:
            self._known = state, MeshIndex(self._mesh)
        return self._known[1]


if hasattr(_pyvista, "register_dataset_accessor"):
    _pyvista.register_dataset_accessor("sdm", _pyvista.PolyData)(SurfaceAccessor)
