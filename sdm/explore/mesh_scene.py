"""A mesh with its map, by each method of saying what is inside, and its winding number."""

from __future__ import annotations

import warnings
from typing import Any

import torch

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import SDMWarning
from sdm.explore.controls import Choice, Control, Shown, Switch, Values

QUANTITY, SURFACE = "plane shows", "surface of the map"
BY_WINDING, BY_FLOOD, BY_NONE = "distance, sign by winding", "distance, sign by flood", "distance, no sign"
WINDING = "winding number"
SIGNS: dict[str, Any] = {BY_WINDING: "winding", BY_FLOOD: "flood", BY_NONE: "none"}
HALF = 0.5


class MeshScene:
    """A mesh, closed or not.

    Args:
        mesh: Any triangles.
        resolution: Voxels along each axis of its map.
        device: Where maps are computed.
    """

    def __init__(self, mesh: TriangleMesh, resolution: int, device: torch.device) -> None:
        self.title = mesh.name or "mesh"
        self.mesh = mesh.to("cpu")
        self.index = MeshIndex(mesh, device=device)
        self.grid = Grid.around(mesh, resolution=resolution)
        self.controls: list[Control] = [Choice(QUANTITY, (*SIGNS, WINDING)), Switch(SURFACE)]
        self._known: dict[str, SDM] = {}

    def show(self, values: Values) -> Shown:
        """The mesh, or the surface of its map, with the map that the plane cuts."""
        quantity = str(values.get(QUANTITY, BY_WINDING))
        field = self._map(quantity)
        kind = "closed" if self.index.closed else "open"
        note = f"{len(self.mesh.faces):,} triangles, {kind}; {'×'.join(map(str, field.grid.shape))} voxels"
        if quantity == WINDING:
            note += "; inside is where the winding number is above 0.5"
        elif quantity != BY_NONE:
            note += f"; {field.inside_voxels:,} voxels inside"
            other = self._map(BY_FLOOD if quantity == BY_WINDING else BY_WINDING, only_known=True)
            if other is not None:
                differ = int(((other.values < 0) != (field.values < 0)).sum())
                note += f", {differ:,} of them or others differ by the other sign"
        surface = self.mesh
        if values.get(SURFACE) and quantity != BY_NONE and field.inside_voxels:
            # Inside is where the winding number is above a half: of the surface, only the side is another.
            surface = field.with_values(HALF - field.values).to_mesh() if quantity == WINDING else field.to_mesh()
        return Shown(
            surface.vertices.detach().numpy(),
            surface.faces.numpy(),
            field,
            note,
            quantity=WINDING if quantity == WINDING else "signed distance" if quantity != BY_NONE else "distance",
            scale_end=HALF if quantity == WINDING else None,
            centre=HALF if quantity == WINDING else 0.0,
        )

    def _map(self, quantity: str, *, only_known: bool = False) -> Any:
        if quantity not in self._known and not only_known:
            with torch.no_grad(), warnings.catch_warnings():
                # Odd meshes are here on purpose, and the page shows how they are.
                warnings.simplefilter("ignore", SDMWarning)
                if quantity == WINDING:
                    values = self.index.winding_number(self.grid.points().to(self.index.device))
                    self._known[quantity] = SDM(values.reshape(self.grid.shape).cpu(), self.grid)
                else:
                    found = self.index.signed_distance_map(self.grid, sign=SIGNS[quantity])
                    self._known[quantity] = found.cpu()
        return self._known.get(quantity)
