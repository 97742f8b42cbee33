"""Maps computed in the workers of a DataLoader, as users do today."""

from __future__ import annotations

import time

import torch
from torch import Tensor
from torch.utils.data import Dataset

from bench.meshes import Case
from bench.peers import CPU_ONLY, Peer
from sdm import Grid, TriangleMesh
from sdm.shapes import Family

# Longer than this for one map, and a library is out of the running [s].
SLOWEST = 60.0
# Grids that every library is first asked for, to leave the slow ones out.
FIRST = 12


class PeerMaps(Dataset[tuple[Tensor, Tensor]]):
    """Random shapes and their maps, each worker on one core, by a library of `bench.peers`."""

    def __init__(self, family: Family, grid: Grid, peer: str) -> None:
        self._family, self._grid, self._peer = family, grid, peer

    def __len__(self) -> int:
        return 1 << 40

    def __getitem__(self, item: int) -> tuple[Tensor, Tensor]:
        theta = self._family.sample_at(torch.tensor([item]))
        peer = peer_by_name(self._peer)
        return theta[0], measure(peer, self._family.mesh(theta[0]), self._grid)[None]


def peer_by_name(name: str) -> Peer:
    return next(peer for peer in (make() for make in CPU_ONLY) if peer.name == name)


def measure(peer: Peer, mesh: TriangleMesh, grid: Grid) -> Tensor:
    """A new mesh each time, so its structure counts."""
    peer.build(Case("sample", *mesh.numpy(), frozenset()))
    peer.prepare(grid)
    return peer.signed_distance_map(grid).float()


def best_peer(family: Family, grid: Grid) -> tuple[str, float]:
    """The library that is there and computes a map of the family soonest, with structure; and the seconds it took."""
    mesh = family.mesh(family.sample(1, device="cpu")[0])
    found: list[tuple[float, str]] = []
    for peer in (make() for make in CPU_ONLY):
        if not peer.available():
            continue
        begin = time.perf_counter()
        measure(peer, mesh, family.grid(FIRST))
        if (time.perf_counter() - begin) * grid.size / FIRST**3 > SLOWEST:
            continue
        begin = time.perf_counter()
        measure(peer, mesh, grid)
        found.append((time.perf_counter() - begin, peer.name))
    if not found:
        raise SystemExit("no other CPU library is installed: pip install 'warp-sdm[bench]'")
    seconds, name = min(found)
    return name, seconds
