"""Warp's `swept_volume_field` of a mesh that does not move: its dense signed distance field in a box."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from torch import Tensor

from sdm import Grid
from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer
from sdm.bench.peers.warp import on_torch_stream, stock_mesh

# One mesh, one pose: no translation, no rotation (x, y, z, then the quaternion x, y, z, w).
AT_REST = np.array([[[0, 0, 0, 0, 0, 0, 1]]], np.float32)


class SweptVolume(Peer):
    """`warp.geometry.swept_volume_field`."""

    name, package, module = "Warp swept volume", "warp-lang", "warp.geometry"
    points_too = False

    def __init__(self, device: str) -> None:
        self.device = device
        self.note = "one pose" if device.startswith("cuda") else "one pose, one thread"

    def build(self, case: Case) -> None:
        self._at_rest: Any
        with on_torch_stream(self.device):
            self._mesh = stock_mesh(case, self.device)
            self._at_rest = wp.array(AT_REST, dtype=wp.transform, device=self.device)

    def signed_distance(self, points: Tensor) -> Tensor:
        raise NotImplementedError("swept_volume_field fills grids only")

    def prepare(self, grid: Grid) -> None:
        """Nothing: it takes two corners and a shape."""

    def signed_distance_map(self, grid: Grid) -> Tensor:
        import warp.geometry

        last = np.asarray(grid.origin) + np.asarray(grid.spacing) * (np.asarray(grid.shape) - 1)
        with on_torch_stream(self.device):
            field: Any
            field, _, _ = warp.geometry.swept_volume_field(
                [self._mesh], self._at_rest, resolution=grid.shape, lower=grid.origin, upper=tuple(last)
            )
        return wp.to_torch(field)
