"""MeshLib: dense distance volumes, with its winding numbers for the sign."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import torch
from torch import Tensor

from sdm import Grid
from sdm.bench.common.meshes import Case
from sdm.bench.peers.base import Peer

# More than any squared distance.
FAR = 3.0e38


class MeshLib(Peer):
    """`meshToDistanceVolume` with `SignDetectionMode.HoleWindingRule`, on the CPU."""

    name, package, module = "MeshLib", "meshlib", "meshlib.mrmeshpy"
    note = "meshToDistanceVolume, HoleWindingRule"
    points_too = False

    def build(self, case: Case) -> None:
        meshes: Any = import_module("meshlib.mrmeshnumpy")
        self._numpy = meshes
        self._mesh = meshes.meshFromFacesVerts(case.faces.astype(np.int32), case.vertices.astype(np.float32))
        # Its tree is made when it is first asked.
        self._mesh.getAABBTree()

    def signed_distance(self, points: Tensor) -> Tensor:
        raise NotImplementedError("meshToDistanceVolume fills grids only")

    def prepare(self, grid: Grid) -> None:
        """Nothing: it takes an origin, a spacing and a shape."""

    def signed_distance_map(self, grid: Grid) -> Tensor:
        meshlib, asked = self.library, self.library.MeshToDistanceVolumeParams()
        # It measures at the middle of voxels whose first corner is the origin.
        corner = np.asarray(grid.origin) - np.asarray(grid.spacing) / 2
        asked.vol.origin = meshlib.Vector3f(*corner.tolist())
        asked.vol.voxelSize = meshlib.Vector3f(*grid.spacing)
        asked.vol.dimensions = meshlib.Vector3i(*grid.shape)
        asked.dist.signMode = meshlib.SignDetectionMode.HoleWindingRule
        asked.dist.maxDistSq = FAR
        self._choose(asked)
        volume = meshlib.meshToDistanceVolume(meshlib.MeshPart(self._mesh), asked)
        return torch.from_numpy(self._numpy.getNumpy3Darray(volume)).float()

    def _choose(self, asked: Any) -> None:
        """Nothing: it has winding numbers of its own."""


class MeshLibCuda(MeshLib):
    """The same with winding numbers from a GPU; distances stay on the CPU, and so does the map."""

    name, module, device = "MeshLib, CUDA signs", "meshlib.mrcudapy", "cuda"
    note = "meshToDistanceVolume, HoleWindingRule by mrcudapy; distances on the CPU"

    def __init__(self, device: str = "cuda") -> None:
        self.device = device

    @property
    def library(self) -> Any:
        return import_module("meshlib.mrmeshpy")

    def build(self, case: Case) -> None:
        super().build(case)
        self._winding = import_module(self.module).FastWindingNumber(self._mesh)

    def _choose(self, asked: Any) -> None:
        asked.fwn = self._winding
