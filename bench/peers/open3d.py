"""Open3D: Embree for distances, and for the sign by parity."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer


class Open3D(Peer):
    """`open3d.t.geometry.RaycastingScene`."""

    name, package, module = "Open3D", "open3d", "open3d"
    note = "RaycastingScene, one ray"
    parts = ("distance", "sign")

    def build(self, case: Case) -> None:
        open3d = self.library
        self._tensor = open3d.core.Tensor
        self._scene = open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(self._tensor(case.vertices), self._tensor(case.faces.astype(np.uint32)))
        # Embree builds when it is first asked.
        self._scene.compute_distance(self._tensor(np.zeros((1, 3), np.float32)))

    def signed_distance(self, points: Tensor) -> Tensor:
        return torch.from_numpy(self._scene.compute_signed_distance(self._tensor(points.numpy())).numpy())

    def unsigned_distance(self, points: Tensor) -> Tensor:
        return torch.from_numpy(self._scene.compute_distance(self._tensor(points.numpy())).numpy())

    def inside(self, points: Tensor) -> Tensor:
        return torch.from_numpy(self._scene.compute_occupancy(self._tensor(points.numpy())).numpy() > 0.5)
