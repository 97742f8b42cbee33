"""libigl at its best: one tree and one query a step, with the derivatives that its closest points give.

The same meshes, points and formula as the exact backend's; only who is asked for the closest point differs. So both end
at the same estimate, and the race is between the two engines. libigl uses threads from 10,000 points a call on, and
most calls of a fit are of fewer: those with more than a thread's share of these are filled up, which is quicker.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from sdm.bench.common.meshes import Case
from sdm.bench.peers.libigl import THREADS_FROM, LibiglWinding
from sdm.core.mesh import TriangleMesh
from sdm.engine.points import PointsIndex
from sdm.fit import ExactBackend


class ClosestPointBackend(ExactBackend):
    """The exact backend with libigl's tree and winding numbers in the engine's place."""

    name = "libigl, closest points"

    def _indexed(self, mesh: TriangleMesh) -> PointsIndex:
        """libigl's structures of a mesh, by the two calls that the backend makes."""
        return cast("PointsIndex", _Libigl(mesh))


@dataclass(frozen=True, eq=False)
class _Hit:
    faces: Tensor
    barycentric: Tensor


def filled_up(points: Tensor, threads: int | None = None) -> Tensor:
    """Points (N,3), or 10,000 with those again and again where all threads have these sooner than one thread N."""
    share = THREADS_FROM / (len(os.sched_getaffinity(0)) if threads is None else threads)
    if not share < len(points) < THREADS_FROM:
        return points
    return points.repeat(-(-THREADS_FROM // len(points)), 1)[:THREADS_FROM]


class _Libigl(LibiglWinding):
    def __init__(self, mesh: TriangleMesh) -> None:
        super().__init__()
        vertices, faces = mesh.numpy()
        self.build(Case(name=mesh.name, vertices=vertices, faces=faces, tags=frozenset({"closed"})))

    def signed_distance(self, points: Tensor, *, return_closest: bool = False) -> Any:
        count, points = len(points), filled_up(points)
        at = points.numpy().astype(np.float64)
        squared, faces, closest = (found[:count] for found in self._tree.squared_distance(*self._mesh, at))
        distance = torch.from_numpy(np.sqrt(squared))
        values = torch.where(self.inside(points)[:count], -distance, distance)
        if not return_closest:
            return values
        a, b, c = self._mesh[0][self._mesh[1][faces.ravel()]].transpose(1, 0, 2)
        across = np.cross(b - a, c - a)
        area = np.maximum((across**2).sum(1), 1e-300)
        second = (np.cross(closest - a, c - a) * across).sum(1) / area
        third = (np.cross(b - a, closest - a) * across).sum(1) / area
        weights = np.stack([1 - second - third, second, third], 1).clip(0, 1)
        return values, _Hit(torch.from_numpy(faces.ravel().astype(np.int64)), torch.from_numpy(weights))
