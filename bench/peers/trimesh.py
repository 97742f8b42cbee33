"""trimesh: its proximity query, and embreex's rays for the sign by parity."""

from __future__ import annotations

import importlib.util

import numpy as np
import torch
from torch import Tensor

from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer


class Trimesh(Peer):
    """`trimesh.proximity.closest_point` and `mesh.ray.contains_points`."""

    name, package, module = "trimesh + embreex", "trimesh", "embreex"
    note = "proximity, parity"
    parts = ("distance", "sign")

    def missing(self) -> str | None:
        found = super().missing()
        if found is not None:
            return found
        if importlib.util.find_spec("rtree") is None:
            return f"{self.name} needs rtree for its proximity query, which is not installed"
        return None

    def build(self, case: Case) -> None:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        self._mesh = trimesh.Trimesh(case.vertices, case.faces, process=False)
        self._rays = RayMeshIntersector(self._mesh)
        # Both structures are made when they are first asked.
        once = np.zeros((1, 3))
        trimesh.proximity.closest_point(self._mesh, once)
        self._rays.contains_points(once)

    def signed_distance(self, points: Tensor) -> Tensor:
        distance = self.unsigned_distance(points)
        return torch.where(self.inside(points), -distance, distance)

    def unsigned_distance(self, points: Tensor) -> Tensor:
        import trimesh

        return torch.from_numpy(trimesh.proximity.closest_point(self._mesh, points.numpy())[1])

    def inside(self, points: Tensor) -> Tensor:
        return torch.from_numpy(self._rays.contains_points(points.numpy()))
