"""The libraries that `sdm` is measured against, and `sdm` itself, behind one face: see `Peer`."""

from __future__ import annotations

from sdm.bench.peers.base import Peer
from sdm.bench.peers.libigl import LibiglPseudonormal, LibiglWinding
from sdm.bench.peers.meshlib import MeshLib, MeshLibCuda
from sdm.bench.peers.open3d import Open3D
from sdm.bench.peers.physicsnemo import PhysicsNeMo
from sdm.bench.peers.point_cloud_utils import PointCloudUtils
from sdm.bench.peers.sdm import Sdm
from sdm.bench.peers.swept_volume import SweptVolume
from sdm.bench.peers.trimesh import Trimesh
from sdm.bench.peers.trueform import Trueform
from sdm.bench.peers.warp import StockWarp, StockWarpSah

__all__ = ["LibiglWinding", "Open3D", "Peer", "StockWarp", "StockWarpSah", "SweptVolume", "all_peers"]

CPU_ONLY = (Open3D, LibiglWinding, LibiglPseudonormal, PointCloudUtils, Trimesh, Trueform, MeshLib)


def all_peers(device: str) -> list[Peer]:
    """Every peer that could run on `device`, installed or not; the CPU's libraries only for `"cpu"`."""
    peers: list[Peer] = [Sdm(device), StockWarp(device), SweptVolume(device), PhysicsNeMo(device)]
    if device.startswith("cuda"):
        return [*peers, StockWarpSah(device), MeshLibCuda(device)]
    return [*peers, *(make() for make in CPU_ONLY)]
