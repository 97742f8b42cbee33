"""Stock Warp: its own closest-point query with the winding number's sign, one thread a voxel in (i,j,k) order.

On a GPU by two trees: the linear one (LBVH), which is quick to build, and the one by the surface area heuristic (SAH),
which is quicker to query.
"""

from __future__ import annotations

import contextlib
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm import Grid
from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer
from sdm.bench.peers.warp_kernels import distance_kernel, grid_kernel, points_kernel

# The leaf size that was fastest on the GPUs measured; the winding number's accuracy is Warp's default.
LEAF_SIZE = 4


def on_torch_stream(device: str) -> AbstractContextManager[Any]:
    """Launches go where torch's events wait for them."""
    if not device.startswith("cuda"):
        return contextlib.nullcontext()
    return wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(device)))


def stock_mesh(case: Case, device: str, builder: str = "lbvh") -> wp.Mesh:
    """A mesh with Warp's hierarchy for distances and winding numbers."""
    return wp.Mesh(
        points=wp.array(case.vertices, dtype=wp.vec3, device=device),
        indices=wp.array(case.faces.reshape(-1), dtype=wp.int32, device=device),
        support_winding_number=True,
        # The linear builder exists on GPUs alone; on CPUs Warp has the surface area heuristic.
        bvh_constructor=builder if device.startswith("cuda") else "sah",
        bvh_leaf_size=LEAF_SIZE,
    )


class StockWarp(Peer):
    """`mesh_query_point_sign_winding_number`."""

    name, package, module = "Warp winding number", "warp-lang", "warp"
    parts = ("distance",)
    builder = "lbvh"

    def __init__(self, device: str) -> None:
        self.device = device
        self.note = f"{self.builder.upper()}, leaf 4" if device.startswith("cuda") else "SAH, leaf 4, one thread"

    def build(self, case: Case) -> None:
        with on_torch_stream(self.device):
            self._mesh = stock_mesh(case, self.device, self.builder)
        low, high = case.box
        # A query that reaches too short returns nothing; its square must not overflow.
        self._reach = float(min(1e4 * np.linalg.norm(high - low) + 1e4 * np.abs(high).max(), 1e18))

    def signed_distance(self, points: Tensor) -> Tensor:
        return self._launch(points_kernel, points)

    def unsigned_distance(self, points: Tensor) -> Tensor:
        return self._launch(distance_kernel, points)

    def prepare(self, grid: Grid) -> None:
        """Nothing: the kernel knows where the voxels are."""

    def signed_distance_map(self, grid: Grid) -> Tensor:
        out = torch.empty(grid.shape, dtype=torch.float32, device=self.device)
        with on_torch_stream(self.device):
            origin, spacing = wp.vec3(*grid.origin), wp.vec3(*grid.spacing)
            inputs = [self._mesh.id, origin, spacing, self._reach, wp.from_torch(out)]
            wp.launch(grid_kernel, dim=grid.shape, inputs=inputs, device=self.device)
        return out

    def _launch(self, kernel: Any, points: Tensor) -> Tensor:
        out = torch.empty(points.shape[0], dtype=torch.float32, device=self.device)
        with on_torch_stream(self.device):
            inputs = [self._mesh.id, wp.from_torch(points, dtype=wp.vec3), self._reach, wp.from_torch(out)]
            wp.launch(kernel, dim=points.shape[0], inputs=inputs, device=self.device)
        return out


class StockWarpSah(StockWarp):
    """The same with a tree by the surface area heuristic; for GPUs, as `StockWarp` has that tree on CPUs."""

    name = "Warp winding number, SAH"
    builder = "sah"
