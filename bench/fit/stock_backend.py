"""Distances by a stock library on the CPU, their derivatives by finite differences: a mesh method without ours.

Forward differences: one mesh more for each shape parameter, and one query more for each axis. The fit around it is
the same, and so are the points that it asks about: only those near the surface, which spares it most of what a method
that fills whole grids has to do.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer
from sdm.bench.peers.libigl import LibiglWinding
from sdm.bench.peers.warp import StockWarp
from sdm.fit.model.backend import Distances
from sdm.fit.model.exact import ROUGH_TRIANGLES, TRIANGLES, ExactBackend
from sdm.shapes import Cochlea

# Share of each parameter's range, and millimetres: far above the rounding of float32, far below a voxel.
STEP_OF_RANGE = 1e-3
STEP_MM = 1e-3


class StockBackend:
    """A library's signed distances to the same meshes as the exact backend's.

    Args:
        name: "libigl" or "warp".
        triangles: As the exact backend's.
    """

    slack = 1e-4

    def __init__(self, name: str, triangles: int = TRIANGLES) -> None:
        self.name = self.library = name
        self.device = torch.device("cpu")
        self.family = Cochlea(triangles)
        self.parameters = self.family.parameters
        self.centre = ExactBackend(self.family, "cpu").centre
        self.evaluations = 0
        self._faces = self.family.faces.numpy()
        self._theta: Tensor | None = None
        self._peer = self._new_peer()

    def rough(self) -> StockBackend | None:
        """As the exact backend's."""
        if self.family.faces.shape[0] <= 2 * ROUGH_TRIANGLES:
            return None
        rough = StockBackend(self.library, ROUGH_TRIANGLES)
        rough.name, rough.centre = f"{self.name}, rough", self.centre
        return rough

    def distances(self, theta: Tensor, points: Tensor) -> Tensor:
        """Signed distances (N,) float64 of points (N,3) float64 for theta (P,)."""
        if self._theta is None or not torch.equal(theta, self._theta):
            self._peer, self._theta = self.built(theta), theta.clone()
        return self._peer.signed_distance(points.float()).double()

    def with_derivatives(self, theta: Tensor, points: Tensor) -> Distances:
        """The same with forward differences."""
        values = self.distances(theta, points)
        by_point = [
            (self._peer.signed_distance((points + STEP_MM * axis).float()).double() - values) / STEP_MM
            for axis in torch.eye(3, dtype=torch.float64)
        ]
        by_theta = []
        for column, parameter in enumerate(self.parameters):
            step = torch.zeros_like(theta)
            step[column] = STEP_OF_RANGE * (parameter.high - parameter.low)
            moved = self.built(theta + step).signed_distance(points.float()).double()
            by_theta.append((moved - values) / step[column])
        return Distances(values, torch.stack(by_theta, 1), torch.stack(by_point, 1))

    def built(self, theta: Tensor) -> Peer:
        """The library with the mesh for theta (P,)."""
        self.evaluations += 1
        vertices = self.family.vertices(theta.float()[None])[0].numpy()
        peer = self._new_peer()
        peer.build(
            Case(name="cochlea", vertices=vertices.astype(np.float32), faces=self._faces, tags=frozenset({"closed"}))
        )
        return peer

    def _new_peer(self) -> Peer:
        return LibiglWinding() if self.library == "libigl" else StockWarp("cpu")
