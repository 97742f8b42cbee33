"""The libraries that `sdm` is measured against, and `sdm` itself, behind one face: see `Peer`."""

from __future__ import annotations

from bench.peers._base import Peer
from bench.peers._libigl import LibiglPseudonormal, LibiglWinding
from bench.peers._open3d import Open3D
from bench.peers._pcu import PointCloudUtils
from bench.peers._sdm import Sdm
from bench.peers._swept_volume import SweptVolume
from bench.peers._trimesh import Trimesh
from bench.peers._warp import StockWarp

__all__ = ["LibiglWinding", "Open3D", "Peer", "StockWarp", "SweptVolume", "all_peers"]

CPU_ONLY = (Open3D, LibiglWinding, LibiglPseudonormal, PointCloudUtils, Trimesh)


def all_peers(device: str) -> list[Peer]:
    """Every peer that could run on `device`, installed or not; the CPU's libraries only for `"cpu"`."""
    peers: list[Peer] = [Sdm(device), StockWarp(device), SweptVolume(device)]
    return peers if device.startswith("cuda") else [*peers, *(make() for make in CPU_ONLY)]
