"""libigl: its tree for distances, with two ways to the sign. float64 throughout."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer

# `igl::parallel_for` in AABB.cpp and fast_winding_number.cpp: below this many queries it stays on one thread.
THREADS_FROM = 10_000


class LibiglWinding(Peer):
    """`igl.AABB` and `igl.FastWindingNumberBVH`, both kept."""

    name, package, module = "libigl winding number", "libigl", "igl"
    note = "AABB + fast winding number"
    parts = ("distance", "sign")
    fewest_points = THREADS_FROM

    def build(self, case: Case) -> None:
        igl = self.library
        self._mesh = case.vertices.astype(np.float64), case.faces.astype(np.int64)
        self._tree, self._winding = igl.AABB(), igl.FastWindingNumberBVH()
        self._tree.init(*self._mesh)
        self._winding.init(*self._mesh)

    def signed_distance(self, points: Tensor) -> Tensor:
        distance = self.unsigned_distance(points)
        return torch.where(self.inside(points), -distance, distance)

    def unsigned_distance(self, points: Tensor) -> Tensor:
        squared, _, _ = self._tree.squared_distance(*self._mesh, points.numpy().astype(np.float64))
        return torch.from_numpy(np.sqrt(squared))

    def inside(self, points: Tensor) -> Tensor:
        return torch.from_numpy(self._winding.winding_number(points.numpy().astype(np.float64)) > 0.5)


class LibiglPseudonormal(Peer):
    """`igl.signed_distance` with the angle-weighted pseudonormal's sign; it makes its tree for every call."""

    name, package, module = "libigl pseudonormal", "libigl", "igl"
    note = "tree built in the query"
    fewest_points = THREADS_FROM

    def build(self, case: Case) -> None:
        self._mesh = case.vertices.astype(np.float64), case.faces.astype(np.int64)

    def signed_distance(self, points: Tensor) -> Tensor:
        igl = self.library
        kind = igl.SignedDistanceType.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
        return torch.from_numpy(igl.signed_distance(points.numpy().astype(np.float64), *self._mesh, kind)[0])
