"""This project."""

from __future__ import annotations

import torch
from torch import Tensor

import sdm
from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer


class Sdm(Peer):
    """`sdm.MeshIndex`: maps and points."""

    name, package, module = "sdm", "warp-sdm", "sdm"
    note = "MeshIndex"
    parts = ("sign",)

    def __init__(self, device: str) -> None:
        self.device = device

    def build(self, case: Case) -> None:
        vertices = torch.from_numpy(case.vertices).to(self.device)
        faces = torch.from_numpy(case.faces).to(self.device)
        self._index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces, case.name, check=False), self.device)

    def signed_distance(self, points: Tensor) -> Tensor:
        return self._index.signed_distance(points)

    def inside(self, points: Tensor) -> Tensor:
        return self._index.winding_number(points) > 0.5

    def prepare(self, grid: sdm.Grid) -> None:
        """Nothing: a grid is all it needs."""

    def signed_distance_map(self, grid: sdm.Grid) -> Tensor:
        return self._index.signed_distance_map(grid).values
