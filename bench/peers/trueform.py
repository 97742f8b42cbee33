"""trueform: its tree with fast winding numbers for points, and for maps crossing parity on an integer lattice."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from sdm import Grid
from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer


class Trueform(Peer):
    """`trueform.signed_distance` of points, and `trueform.mesh_sdf(mode="exact")` of grids."""

    name, package, module = "trueform", "trueform", "trueform"
    note = "mesh_sdf exact; points by winding number"
    parts = ("sign",)

    def build(self, case: Case) -> None:
        trueform = self.library
        self._mesh = trueform.Mesh(case.faces.astype(np.int32), case.vertices.astype(np.float32))
        # Tree and moments are made when they are first asked.
        trueform.signed_distance(self._mesh, np.zeros((2, 3), np.float32))

    def signed_distance(self, points: Tensor) -> Tensor:
        return torch.from_numpy(self.library.signed_distance(self._mesh, points.numpy()))

    def inside(self, points: Tensor) -> Tensor:
        return torch.from_numpy(self.library.winding_number(self._mesh, points.numpy()) > 0.5)

    def prepare(self, grid: Grid) -> None:
        """Nothing: it takes an origin, a spacing and a shape."""

    def signed_distance_map(self, grid: Grid) -> Tensor:
        field = self.library.mesh_sdf(self._mesh, grid.shape, grid.spacing, grid.origin)
        return torch.from_numpy(np.ascontiguousarray(field.samples))
