"""MeshLib: dense distance volumes, with its winding numbers for the sign."""

from __future__ import annotations

import ctypes
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
# How many sizes away a part of the mesh is one dipole: its own default.
BETA = 2.0


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
    """Distances and winding numbers from a GPU: of grids by `meshToDistanceVolume`, of points by its two searches.

    Points and what is found come from the host and return to it. Signs at points are not to be relied on: the kernel of
    `calcFromVector` adds to its result, which is memory as `cudaMalloc` gave it (`processPoint` and `resVec` in
    MRCudaFastWindingNumber.cu, from the first version in 2023 to August 2026 at least). What was freed there before, as
    coordinates or a box of its tree, is part of the number. Grids' are summed in a variable that begins at zero.
    """

    name, module, device = "MeshLib, CUDA", "meshlib.mrcudapy", "cuda"
    note = "mrcudapy: meshToDistanceVolume with its FastWindingNumber; its PointsToMeshProjector at points"
    parts = ("distance", "sign")
    points_too = True

    def __init__(self, device: str = "cuda") -> None:
        self.device = device

    @property
    def library(self) -> Any:
        return import_module("meshlib.mrmeshpy")

    def missing(self) -> str | None:
        """Why it cannot run here: also what it says of one point."""
        if (why := super().missing()) is not None:
            return why
        try:
            self.build(Case("corner", np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32), frozenset()))
            self.signed_distance(torch.zeros(1, 3))
        except Exception as error:  # noqa: BLE001
            return f"{self.name} is installed but does not run on {self.device}: {error}"
        return None

    def build(self, case: Case) -> None:
        super().build(case)
        there = import_module(self.module)
        self._winding = there.FastWindingNumber(self._mesh)
        self._projector = there.PointsToMeshProjector()
        self._projector.updateMeshData(self._mesh)

    def _choose(self, asked: Any) -> None:
        asked.fwn = self._winding

    def points_for(self, points: Tensor) -> Any:
        """Points (N,3) as it takes them."""
        return self._numpy.fromNumpyArray(points.detach().cpu().numpy())

    def distances_at(self, points: Any) -> Any:
        """Results about the closest points of `points_for`."""
        found = self.library.std_vector_MeshProjectionResult()
        self._projector.findProjections(found, points, None, None, FAR, 0.0)
        return found

    def winding_at(self, points: Any) -> Any:
        """Winding numbers at `points_for`."""
        meshlib, found = self.library, self.library.std_vector_float()
        self._winding.calcFromVector(found, points, BETA, meshlib.FaceId(), meshlib.func_bool_from_float())
        return found

    def signed_distance(self, points: Tensor) -> Tensor:
        given = self.points_for(points)
        return signed(self.distances_at(given), self.winding_at(given)).to(self.device)

    def unsigned_distance(self, points: Tensor) -> Tensor:
        return _lengths(self.distances_at(self.points_for(points))).to(self.device)

    def inside(self, points: Tensor) -> Tensor:
        return (_floats(self.winding_at(self.points_for(points)), 1)[:, 0] > 0.5).to(self.device)


def signed(distances: Any, winding: Any) -> Tensor:
    """Signed distances (N,) of what `distances_at` and `winding_at` found."""
    lengths = _lengths(distances)
    return torch.where(_floats(winding, 1)[:, 0] > 0.5, -lengths, lengths)


def _lengths(distances: Any) -> Tensor:
    # The square is the last of eight words of a result.
    return _floats(distances, 8)[:, 7].sqrt()


def _floats(vector: Any, words: int) -> Tensor:
    """A vector of C++ as floats (N, words), copied."""
    count = vector.size()
    if count == 0:
        return torch.empty(0, words)
    memory = (ctypes.c_float * (count * words)).from_address(vector.data_pointer())
    return torch.from_numpy(np.frombuffer(memory, np.float32).reshape(count, words).copy())
