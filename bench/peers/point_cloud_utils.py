"""point-cloud-utils: Embree for distances, the fast winding number for the sign."""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer


class PointCloudUtils(Peer):
    """`signed_distance_to_mesh`; it makes its structures for every call."""

    name, package, module = "point-cloud-utils", "point-cloud-utils", "point_cloud_utils"
    note = "structures built in the query"
    parts = ("distance", "sign")

    def build(self, case: Case) -> None:
        self._mesh = case.vertices, case.faces

    def signed_distance(self, points: Tensor) -> Tensor:
        return torch.from_numpy(self.library.signed_distance_to_mesh(points.numpy(), *self._mesh)[0])

    def unsigned_distance(self, points: Tensor) -> Tensor:
        return torch.from_numpy(self.library.closest_points_on_mesh(points.numpy(), *self._mesh)[0])

    def inside(self, points: Tensor) -> Tensor:
        winding = self.library.triangle_soup_fast_winding_number(*self._mesh, points.numpy())
        return torch.from_numpy(winding) > 0.5
